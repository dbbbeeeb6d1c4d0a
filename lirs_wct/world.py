"""World: ground, start poses, export options and georeference of a site."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lirs_wct.display import ShownAsPicture
from lirs_wct.errors import ConfigError, SourceError, reason_of
from lirs_wct.files import atomic_write, referenced_file, write_json
from lirs_wct.geometry import BoolArray, FloatArray, HeightField, OccupancyGrid, Pose2, Pose3, WallGrid
from lirs_wct.geometry.geodesy import CoordinateSystem, Place
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.ground import ExportOptions, Ground, LaserMap, MeshGround, Terrain
from lirs_wct.navigation import (
    FOOTPRINTS,
    cause_of_refusal,
    mapped_area,
    nearest_place,
    overlaid,
    spawn_poses,
    traversable_by,
)

SCHEMA = 1
JSON, ARRAYS = "world.json", "world.npz"
"""Files of a world: metadata, and exact arrays."""
CELLS = (1e-5, 1e6)
"""Smallest and largest distance of two nodes of a stored surface, meters."""
TEXTURES = Path("materials") / "textures"
"""Folder in which Gazebo looks for a model's textures."""
TEXTURE_OPTIONS = ("texture", "wall_texture")
"""Settings that are the user's files: a world's folder holds copies."""


@dataclass(frozen=True)
class World(ShownAsPicture):
    """A site for robots, in meters: x east, y north, z up.

    Attributes:
        name: name that is legal in file names and Gazebo's URIs.
        ground: a terrain, a laser map or a mesh.
        spawn_poses: legal start poses of a robot; the first is the requested one, else the roomiest.
        spawn_for: largest wheeled robot that has spawn poses; empty = none has.
        start: the requested start pose; None = not requested.
        scale: origin of the meters, a text.
        export_options: options of the mesh files.
        source: absolute path of the source, or a bundled name; None = made in code.
        place: georeference; None = unknown.
    """

    name: str
    ground: Ground
    spawn_poses: tuple[Pose2, ...] = ()
    scale: str = "as given"
    export_options: ExportOptions = field(default_factory=ExportOptions)
    source: str | None = None
    spawn_for: str = ""
    start: Pose2 | None = None
    place: Place | None = None

    def __repr__(self) -> str:
        starts = f"{len(self.spawn_poses)} start poses"
        return f"World({self.name!r}, {self.kind}, {self.surface!r}, {starts})"

    def __deepcopy__(self, memo: dict[int, Any]) -> World:
        """Return the world itself: it is a value, and copies of a simulation share it."""
        return self

    @property
    def kind(self) -> Literal["terrain", "map", "mesh"]:
        """`terrain` from a picture, `map` from a laser map, `mesh` from a mesh."""
        return self.ground.kind

    @property
    def surface(self) -> HeightField:
        """Heights of the ground from above."""
        return self.ground.surface

    @property
    def sample_spacing(self) -> float | None:
        """Distance between the source's height samples, meters; None of a laser map or a mesh."""
        return self.ground.sample_spacing or (max(self.surface.cell) if self.kind == "terrain" else None)

    def enclose(self) -> World:
        """Return the world with a wall along the border of a laser map."""
        if not isinstance(self.ground, LaserMap):
            return self
        walls = self.ground.walls.enclose()
        return self if walls is self.ground.walls else replace(self, ground=replace(self.ground, walls=walls))

    @property
    def walls(self) -> WallGrid | None:
        """Walls of a laser map."""
        return self.ground.walls

    @property
    def truth(self) -> OccupancyGrid | None:
        """The input laser map."""
        return self.ground.truth

    @property
    def solid(self) -> TriangleMesh | None:
        """The mesh of a world of kind `mesh`."""
        return self.ground.solid

    @property
    def overhangs(self) -> bool:
        """Whether the world is a mesh with more than one surface on a vertical line."""
        return self.ground.overhangs

    @property
    def no_ground(self) -> BoolArray | None:
        """(rows, cols) whether a node has no ground; None = every node has."""
        return self.ground.no_ground

    @property
    def starts_on_ground(self) -> tuple[Pose3, ...]:
        """Spawn poses, upright at the height of the ground."""
        return tuple(
            Pose3.from_pose2(pose, float(self.surface.height_at(pose.x, pose.y))) for pose in self.spawn_poses
        )

    @cached_property
    def mesh(self) -> TriangleMesh:
        """The whole world as one closed solid: surface or floor with walls, skirt, base.

        It is exact unless a budget is set; rays and contact may use it.

        Raises:
            ConfigError: a laser map or a mesh with overhangs has more triangles than the budget allows.
        """
        return self._within(self.export_options)

    @cached_property
    def file_mesh(self) -> TriangleMesh:
        """The world's mesh for mesh files; a terrain without a budget gets the default one."""
        options = self.file_options
        return self.mesh if options == self.export_options else self._within(options)

    @property
    def file_options(self) -> ExportOptions:
        """Options of the mesh files, including the default budget."""
        if self.kind != "terrain":
            return self.export_options
        return self.export_options.with_default(self.surface)

    def _within(self, options: ExportOptions) -> TriangleMesh:
        mesh, most = self.ground.mesh(options), options.max_triangles
        if most is not None and len(mesh.faces) > most:
            raise ConfigError(
                f"{self.name}: has {len(mesh.faces)} triangles and is not simplified, "
                f"--option max-triangles={most} cannot be kept"
            )
        return mesh

    def traversable(self, *, clearance: float, max_slope: float, resolution: float = 0.1) -> OccupancyGrid:
        """Return a grid whose free cells are legal positions of a robot's center.

        Args:
            clearance: distance that the center keeps from steep ground, walls and the border, meters.
            max_slope: steepest ground that the robot drives, radians, over a baseline of 0.3 m.
            resolution: cell size, meters.

        Raises:
            SourceError: the world is too large for a grid of this resolution.
        """
        return next(self.traversable_by([(clearance, max_slope)], resolution))

    def traversable_by(
        self, limits: Iterable[tuple[float, float]], resolution: float
    ) -> Iterator[OccupancyGrid]:
        """Yield the grid of each pair of clearance, meters, and slope, radians (see `traversable`)."""
        return traversable_by(self.ground, limits, resolution)

    def refusal(
        self, place: tuple[float, float], *, clearance: float, max_slope: float, resolution: float = 0.1
    ) -> tuple[str, str | None]:
        """Return why a robot cannot stand at a position, and the nearest free `x,y`.

        The position is in meters; see `traversable`.
        """
        free = self.traversable(clearance=clearance, max_slope=max_slope, resolution=resolution)
        cause = cause_of_refusal(self.ground, free, place, clearance=clearance, max_slope=max_slope)
        return cause, nearest_place(self.driven(free), place)

    def starts(self, free: OccupancyGrid, count: int = 8) -> tuple[Pose2, ...]:
        """Return start poses spread over the cells that robots are meant to drive (see `spawn_poses`)."""
        return spawn_poses(self.driven(free), count, corridors=self.walls is not None)

    def driven(self, free: OccupancyGrid) -> OccupancyGrid:
        """Return the free cells to be driven; of a laser map, the mapped area."""
        if self.walls is None:
            return free
        inside = overlaid(self._mapped_area.free, self._mapped_area, free)
        return OccupancyGrid.from_mask(~(free.free & inside), free.resolution, free.origin)

    @cached_property
    def _mapped_area(self) -> OccupancyGrid:
        least = FOOTPRINTS[-1]
        free = self.traversable(clearance=least.radius, max_slope=least.max_slope)
        inside = mapped_area(free, least.radius)
        return OccupancyGrid.from_mask(~inside, free.resolution, free.origin)

    def to_geographic(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return latitudes and longitudes, in degrees, of points of the world.

        Raises:
            ConfigError: the world has no georeference, or one of an unknown system.
        """
        if self.place is None:
            raise ConfigError(f"{self.name}: its source does not say where on the earth it lies")
        return self.place.to_geographic(x, y)

    def with_export(self, given: ExportOptions) -> World:
        """Return the world with updated export options; options not given stay unchanged.

        Raises:
            ConfigError: `drape` without a texture, or a wall texture without walls.
        """
        if given.wall_texture and self.walls is None:
            raise ConfigError(f"{self.name}: has no walls, which --option wall-texture is for")
        return replace(self, export_options=self.export_options.updated(given))

    def save(self, folder: str | Path) -> Path:
        """Write `world.json` and its arrays; `World.load` returns exactly the same world.

        Raises:
            OutputError: the folder cannot be written.
        """
        surface, folder = self.surface, Path(folder)
        entry: dict[str, Any] = {
            "schema": SCHEMA,
            "name": self.name,
            "kind": self.kind,
            "scale": self.scale,
            "source": self.source,
            "surface": {"cell": surface.cell, "origin": surface.origin},
            "starts": [astuple(pose) for pose in self.spawn_poses],
            "starts_for": self.spawn_for,
            "arrays": ARRAYS,
        }
        if self.start is not None:
            entry["start"] = astuple(self.start)
        if self.ground.sample_spacing is not None:
            entry["sample_spacing"] = self.ground.sample_spacing
        if self.place is not None:
            entry["place"] = asdict(self.place)
        arrays = {"surface": surface.z}
        _store_ground(self.ground, entry, arrays)
        entry["finish"] = _keep_textures(self.name, asdict(self.export_options), folder)
        with atomic_write(folder / ARRAYS) as path, zipfile.ZipFile(path, "w") as file:
            for name, array in arrays.items():
                member = zipfile.ZipInfo(f"{name}.npy")
                # Compressing heights is slow and hardly makes them smaller.
                member.compress_type = zipfile.ZIP_STORED if name == "surface" else zipfile.ZIP_DEFLATED
                with file.open(member, "w", force_zip64=True) as data:
                    np.lib.format.write_array(data, array, allow_pickle=False)
        write_json(folder / JSON, entry)
        return folder

    @staticmethod
    def load(folder: str | Path) -> World:
        """Read a folder that `save` or `lirs-wct build` wrote.

        Raises:
            SourceError: the folder is not a built world, or is damaged.
        """
        folder = Path(folder)
        path = folder / JSON
        with _checked_content(folder):
            entry = json.loads(path.read_text(encoding="utf-8"))
            if entry["schema"] != SCHEMA:
                raise SourceError(f"{path}: schema {entry['schema']}, this version reads {SCHEMA}")
            with np.load(referenced_file(path, entry["arrays"]), allow_pickle=False) as file:
                arrays = dict(file)
            options = entry.get("finish", {})
            textures = {
                role: referenced_file(path, options[role]) for role in TEXTURE_OPTIONS if options.get(role)
            }
            return World(
                entry["name"],
                _load_ground(entry, arrays),
                tuple(Pose2(*pose) for pose in entry["starts"]),
                entry["scale"],
                ExportOptions(**options | textures),
                source=entry.get("source"),
                spawn_for=str(entry.get("starts_for", "")),
                start=Pose2(*entry["start"]) if "start" in entry else None,
                place=_load_place(entry["place"]) if "place" in entry else None,
            )


@contextmanager
def _checked_content(folder: Path) -> Iterator[None]:
    """Convert errors from missing or damaged files of a world to SourceError."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise SourceError(f"{folder / JSON}: not a built world, or damaged: {reason_of(error)}") from error


def recorded_source(folder: Path) -> str | None:
    """Return the source of the world in a folder; None = unknown."""
    with _checked_content(folder):
        source: str | None = json.loads((folder / JSON).read_text(encoding="utf-8")).get("source")
        return source


def texture_path(name: str, role: str, texture: Path | None) -> Path:
    """Return the path of a texture, user's or drawn, in a world's folder.

    The role is `texture` for the ground, or `wall_texture`.
    """
    stem = name if role == "texture" else f"{name}-walls"
    return TEXTURES / f"{stem}{texture.suffix.lower() if texture else '.png'}"


def _keep_textures(name: str, options: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Copy the user's textures into a world's folder; return options with their new paths."""
    kept = options | {"texture": None}
    for role in TEXTURE_OPTIONS:
        texture: Path | None = options.get(role)
        if texture is not None:
            inside = texture_path(name, role, texture)
            with atomic_write(folder / inside) as path:
                path.write_bytes(texture.read_bytes())
            kept[role] = inside.as_posix()
    return kept


def _store_ground(ground: Ground, entry: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Add the content of a ground to a world's entry and arrays."""
    if ground.walls is not None:
        arrays["walls"] = ground.walls.solid
        entry["walls"] = _grid_entry(ground.walls) | {"height": ground.walls.height}
        if ground.walls.hole is not None:
            arrays["hole"] = ground.walls.hole
    if ground.truth is not None:
        arrays["truth"] = ground.truth.log_odds
        entry["truth"] = _grid_entry(ground.truth)
    if ground.no_ground is not None:
        arrays["bare"] = ground.no_ground
    if ground.solid is not None:
        arrays |= {"vertices": ground.solid.vertices, "faces": ground.solid.faces}
        entry["overhangs"] = ground.overhangs


def _load_ground(entry: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Ground:
    cell = _pair(entry["surface"]["cell"])
    if not CELLS[0] <= min(cell) <= max(cell) <= CELLS[1]:
        raise ValueError(f"cell must be {CELLS[0]:g} to {CELLS[1]:g} m, got {cell}")
    surface = HeightField(arrays["surface"], cell, _pair(entry["surface"]["origin"]))
    if (walls := entry.get("walls")) is not None:
        grid = WallGrid(arrays["walls"], *_grid_placement(walls), walls["height"], arrays.get("hole"))
        truth = entry.get("truth")
        return LaserMap(surface, grid, truth and OccupancyGrid(arrays["truth"], *_grid_placement(truth)))
    if "faces" in arrays:
        solid = TriangleMesh(arrays["vertices"], arrays["faces"])
        return MeshGround(surface, solid, bool(entry.get("overhangs", False)), arrays.get("bare"))
    spacing = float(entry["sample_spacing"]) if "sample_spacing" in entry else None
    return Terrain(surface, arrays.get("bare"), spacing)


def _load_place(entry: dict[str, Any]) -> Place:
    system = entry["system"] | {"ellipsoid": _pair(entry["system"]["ellipsoid"])}
    a, b, c, d, e, f = map(float, entry["affine"])
    return Place(CoordinateSystem(**system), (a, b, c, d, e, f), entry["height"])


def _grid_entry(grid: WallGrid | OccupancyGrid) -> dict[str, Any]:
    return {"resolution": grid.resolution, "origin": astuple(grid.origin)}


def _grid_placement(entry: dict[str, Any]) -> tuple[float, Pose2]:
    return entry["resolution"], Pose2(*entry["origin"])


def _pair(values: list[float]) -> tuple[float, float]:
    return float(values[0]), float(values[1])
