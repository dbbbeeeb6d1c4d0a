"""The world: everything that a consumer needs, and how a source becomes one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

from lirs_wct.arrays import BoolArray
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.export.export_settings import ExportSettings, checked_texture, settings_from
from lirs_wct.formats.map_server import read_map, read_map_picture
from lirs_wct.formats.world_json import read_fields, write_world
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.walls import WallGrid
from lirs_wct.meshing.simplify import simplified_solid
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.meshing.wall_solid import wall_mesh
from lirs_wct.navigation.spawn_poses import spawn_poses
from lirs_wct.navigation.traversability import traversable
from lirs_wct.sources.laser_map import level_floor, walls_of, without_small_walls
from lirs_wct.sources.mesh_source import read_mesh_source
from lirs_wct.sources.options import BuildOptions
from lirs_wct.sources.source import Source, SourceKind, find_source, warn_of_useless
from lirs_wct.sources.terrain_source import read_terrain
from lirs_wct.sources.window import Window, cut_map, cut_nodes, cut_surface

SPAWN_CLEARANCE = 0.8
"""Metres of free ground around a spawn pose: a Husky and a step."""
SPAWN_SLOPE = math.radians(12)
SPAWN_AREA = 200.0
"""Side of the square in the middle of a larger terrain where spawn poses are looked for, metres."""


@dataclass(frozen=True)
class World:
    """A place for robots, in metres: x east, y north, z up.

    Attributes:
        name: fit for file names and Gazebo's URIs.
        kind: `terrain` from a picture, `map` from a laser map, `mesh` from a closed mesh.
        surface: the ground.
        walls: what stands on the ground of a laser map.
        truth: the input laser map.
        spawn_poses: poses where a robot as large as a Husky can be set down, the roomiest first.
        scale: where the metres come from, in words.
        export_settings: how the mesh files are made.
        solid: the true mesh of a world of kind `mesh`.
        overhangs: whether that mesh is more than its heights from above say.
        no_ground: (rows, cols) nodes of the surface where that mesh has no ground; None = it has everywhere.
    """

    name: str
    kind: Literal["terrain", "map", "mesh"]
    surface: HeightField
    walls: WallGrid | None = None
    truth: OccupancyGrid | None = None
    spawn_poses: tuple[Pose2, ...] = ()
    scale: str = "as given"
    export_settings: ExportSettings = field(default_factory=ExportSettings)
    solid: TriangleMesh | None = None
    overhangs: bool = False
    no_ground: BoolArray | None = None

    @cached_property
    def mesh(self) -> TriangleMesh:
        """The whole world as one closed solid, within its budget: surface or floor with walls, skirt, base.

        Raises:
            ConfigError: a laser map or a mesh with overhangs has more triangles than the budget allows.
        """
        settings = self.export_settings
        if self.walls is not None or self.overhangs:
            exact = wall_mesh(self.walls) if self.walls is not None else self.solid
            assert exact is not None
            if settings.max_triangles is not None and len(exact.faces) > settings.max_triangles:
                raise ConfigError(
                    f"{self.name}: has {len(exact.faces)} triangles and is not simplified, "
                    f"--max-triangles {settings.max_triangles} cannot be kept"
                )
            return exact
        if settings.limited:
            return simplified_solid(
                self.surface, max_error=settings.max_error, max_triangles=settings.max_triangles
            )
        return self.solid or solid_mesh(self.surface)

    def traversable(self, *, clearance: float, max_slope: float, resolution: float = 0.1) -> OccupancyGrid:
        """Return a grid whose free cells are where a robot's centre may be (see `traversable`)."""
        return traversable(
            self.surface,
            self.walls,
            self.truth,
            self.no_ground,
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
    """Make a world of a bundled name, a built folder, a picture, a laser map or a mesh.

    Raises:
        SourceError: the source cannot be used.
        ConfigError: an option does not fit the source.
    """
    options = options or BuildOptions()
    found = find_source(source, options)
    warn_of_useless(found, options)
    world = _place(found, options)
    texture = checked_texture(options.texture, options.max_pixels)
    return replace(world, export_settings=settings_from(options, texture, world.export_settings))


def _place(found: Source, options: BuildOptions) -> World:
    if found.kind is SourceKind.LOG:
        raise SourceError(
            f"{found.path}: a log is mapped before it is a world: lirs-wct build does both, and so does "
            "lirs_validation.resolve_source"
        )
    if found.kind is SourceKind.FOLDER:
        return _loaded_world(found, options)
    if found.kind is SourceKind.MESH:
        return _mesh_world(found, options)
    if found.kind in (SourceKind.MAP, SourceKind.MAP_PICTURE):
        return _map_world(found, options)
    return _terrain_world(found, options)


def _loaded_world(source: Source, options: BuildOptions) -> World:
    world = World.load(source.path)
    if options.name is not None:
        world = replace(world, name=source.name)
    if options.window is None:
        return world
    if world.walls is not None or world.overhangs:
        raise ConfigError(f"{source.path}: --window cuts a built terrain only; give the world's own source")
    return _with_spawn_poses(replace(_cut(world, options.window), kind="terrain", solid=None))


def _terrain_world(source: Source, options: BuildOptions) -> World:
    surface, scale = read_terrain(source, options)
    if options.window is not None:
        surface = cut_surface(surface, options.window)
    return _with_spawn_poses(World(source.name, "terrain", surface, scale=scale))


def _mesh_world(source: Source, options: BuildOptions) -> World:
    read = read_mesh_source(source.path, options)
    given = options.size or options.height or options.scale or options.z_scale
    world = World(
        source.name,
        "terrain" if read.solid is None else "mesh",
        read.surface,
        scale="as given" if given else "the file's own",
        solid=read.solid,
        overhangs=read.overhangs and read.solid is not None,
        no_ground=read.no_ground,
    )
    return _with_spawn_poses(world)


def _map_world(source: Source, options: BuildOptions) -> World:
    if source.kind is SourceKind.MAP:
        truth = read_map(source.path, options.max_pixels)
    elif options.resolution is None:
        raise ConfigError(f"{source.path}: a map picture without YAML needs --resolution (metres a pixel)")
    else:
        truth = read_map_picture(source.path, options.resolution, options.origin, options.max_pixels)
    if options.window is not None:
        truth = cut_map(truth, options.window)
    truth = without_small_walls(truth, options.speckle)
    walls = walls_of(truth, options.wall_height, options.unknown)
    scale = f"{truth.resolution:g} m a cell"
    return _with_spawn_poses(World(source.name, "map", level_floor(walls), walls, truth, scale=scale))


def _cut(world: World, window: Window) -> World:
    surface = cut_surface(world.surface, window)
    return replace(world, surface=surface, no_ground=cut_nodes(world.no_ground, world.surface, surface))


def _with_spawn_poses(world: World) -> World:
    """Look for spawn poses; on a terrain of kilometres in its middle only: the search is by the decimetre."""
    place = world
    if world.kind != "map" and max(world.surface.size) > SPAWN_AREA:
        west, south, east, north = world.surface.bounds
        middle = ((west + east) / 2, (south + north) / 2, SPAWN_AREA)
        place = _cut(world, middle)
    free = place.traversable(clearance=SPAWN_CLEARANCE, max_slope=SPAWN_SLOPE)
    return replace(world, spawn_poses=spawn_poses(free))
