"""The world: everything that a consumer needs, and how a source becomes one."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from lirs_wct.bundled import SIZE, bundled_picture
from lirs_wct.errors import ConfigError
from lirs_wct.formats.map_server import read_map, read_map_picture
from lirs_wct.formats.world_json import read_fields, write_world
from lirs_wct.grid import OccupancyGrid
from lirs_wct.heightfield import HeightField
from lirs_wct.image import read_height_field
from lirs_wct.mesh import TriangleMesh
from lirs_wct.occupancy import walls_of
from lirs_wct.options import BuildOptions
from lirs_wct.pose import Pose2
from lirs_wct.solid import solid_mesh
from lirs_wct.source import Source, SourceKind, find_source
from lirs_wct.traversability import start_poses, traversable
from lirs_wct.wall_solid import wall_mesh
from lirs_wct.walls import WallGrid
from lirs_wct.window import cut_map, cut_surface

START_CLEARANCE = 0.8
"""Metres of free ground around a start pose: a Husky and a step."""
START_SLOPE = math.radians(12)
START_AREA = 200.0
"""Side of the square in the middle of a larger terrain where start poses are looked for, metres."""


@dataclass(frozen=True)
class World:
    """A place for robots, in metres: x east, y north, z up.

    Attributes:
        name: fit for file names and Gazebo's URIs.
        kind: `terrain` from a picture, `map` from a laser map.
        surface: the ground.
        walls: what stands on the ground of a laser map.
        truth: the input laser map.
        starts: poses where a robot as large as a Husky can be set down, the roomiest first.
        scale: where the metres come from, in words.
    """

    name: str
    kind: Literal["terrain", "map"]
    surface: HeightField
    walls: WallGrid | None = None
    truth: OccupancyGrid | None = None
    starts: tuple[Pose2, ...] = ()
    scale: str = "as given"

    @cached_property
    def mesh(self) -> TriangleMesh:
        """The whole world as one closed solid: surface or floor with walls, skirt, base."""
        return solid_mesh(self.surface) if self.walls is None else wall_mesh(self.walls)

    def traversable(self, *, clearance: float, max_slope: float, resolution: float = 0.1) -> OccupancyGrid:
        """Return a grid whose free cells are where a robot's centre may be (see `traversable`)."""
        return traversable(
            self.surface,
            self.walls,
            self.truth,
            clearance=clearance,
            max_slope=max_slope,
            resolution=resolution,
        )

    def save(self, folder: str | Path) -> Path:
        """Write `world.json` and its arrays; `World.load` gives the same world back exactly."""
        return write_world(self, Path(folder))

    @staticmethod
    def load(folder: str | Path) -> World:
        """Read a folder that `save` or `lirs-wct build` wrote.

        Raises:
            SourceError: the folder is not a built world, or is damaged.
        """
        return World(**read_fields(Path(folder)))


def build_world(source: str | Path, options: BuildOptions | None = None) -> World:
    """Make a world of a bundled name, a built folder, a picture or a laser map.

    Raises:
        SourceError: the source cannot be used.
        ConfigError: an option does not fit the source.
    """
    options = options or BuildOptions()
    found = find_source(source, options)
    if found.kind is SourceKind.FOLDER:
        world = World.load(found.path)
        return world if options.name is None else replace(world, name=found.name)
    if found.kind in (SourceKind.MAP, SourceKind.MAP_PICTURE):
        return _map_world(found, options)
    return _terrain_world(found, options)


def _terrain_world(source: Source, options: BuildOptions) -> World:
    if source.kind is SourceKind.BUNDLED:
        surface = _bundled_surface(str(source.path), options)
    else:
        surface = read_height_field(source.path, options)
    if options.window is not None:
        surface = cut_surface(surface, options.window)
    return _with_starts(World(source.name, "terrain", surface, scale=_scale(source, options)))


def _bundled_surface(name: str, options: BuildOptions) -> HeightField:
    """Send a bundled picture down the way of every picture: through a file."""
    picture = bundled_picture(name)
    own = replace(
        options,
        size=options.size if options.size or options.pixel_size else SIZE,
        height=options.height or picture.height,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.png"
        cv2.imwrite(str(path), picture.pixels, [cv2.IMWRITE_PNG_COMPRESSION, 0])
        return read_height_field(path, own)


def _map_world(source: Source, options: BuildOptions) -> World:
    if source.kind is SourceKind.MAP:
        truth = read_map(source.path, options.max_pixels)
    elif options.resolution is None:
        raise ConfigError(f"{source.path}: a map picture without YAML needs --resolution (metres a pixel)")
    else:
        truth = read_map_picture(source.path, options.resolution, options.origin, options.max_pixels)
    if options.window is not None:
        truth = cut_map(truth, options.window)
    walls = walls_of(truth, options.wall_height)
    world = World(source.name, "map", _floor(walls), walls, truth, scale=f"{truth.resolution:g} m a cell")
    return _with_starts(world)


def _floor(walls: WallGrid) -> HeightField:
    """Return level ground under the whole map, whatever its yaw."""
    low, high = walls.corners.min(axis=0), walls.corners.max(axis=0)
    flat: NDArray[np.float32] = np.zeros((2, 2), np.float32)
    return HeightField(
        flat, (float(high[0] - low[0]), float(high[1] - low[1])), (float(low[0]), float(low[1]))
    )


def _with_starts(world: World) -> World:
    """Look for start poses; on a terrain of kilometres in its middle only: the search is by the decimetre."""
    place = world
    if world.kind == "terrain" and max(world.surface.size) > START_AREA:
        west, south, east, north = world.surface.bounds
        middle = ((west + east) / 2, (south + north) / 2, START_AREA)
        place = replace(world, surface=cut_surface(world.surface, middle))
    free = place.traversable(clearance=START_CLEARANCE, max_slope=START_SLOPE)
    return replace(world, starts=start_poses(free))


def _scale(source: Source, options: BuildOptions) -> str:
    if source.kind is SourceKind.BUNDLED:
        return "as bundled" if not (options.size or options.pixel_size or options.height) else "as given"
    given = (options.size or options.pixel_size) is not None, options.height is not None
    return {
        (True, True): "as given",
        (False, False): "the file's own, else longer side 50 m, heights 6 m",
    }.get(given, "as given, the rest the file's own or the default")
