"""A world on disk: metadata in `world.json`, exact arrays in `world.npz`."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import atomic_write
from lirs_wct.formats.references import referenced_file
from lirs_wct.geometry import OccupancyGrid, Pose2
from lirs_wct.geometry.geodesy import CoordinateSystem, Place
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.walls import WallGrid

SCHEMA = 1
JSON, ARRAYS = "world.json", "world.npz"
CELLS = (1e-5, 1e6)
"""Smallest and largest distance of two nodes of a stored surface, meters."""
TEXTURES = Path("materials") / "textures"
"""Folder in which Gazebo looks for a model's textures."""
TEXTURE_OPTIONS = ("texture", "wall_texture")
"""Settings that are the user's files: a world's folder holds copies."""


@dataclass(frozen=True, kw_only=True)
class WorldFile:
    """The content of a world's two files.

    Attributes:
        name: of the world.
        kind: `terrain`, `map` or `mesh`.
        scale: source of the metric scale, as text.
        surface: the ground from above.
        spawn_poses: `T_world_base`.
        spawn_for: the largest robot that fits at these poses; empty = none or unknown.
        start: the pose that the user requested; None = no request.
        walls: of a laser map.
        truth: the laser map itself.
        solid: closed mesh of the world.
        overhangs: whether that mesh is more than its heights from above.
        no_ground: (rows, cols) nodes of the surface without ground.
        sample_spacing: of a terrain's source, meters, where the surface was resampled; None = not resampled.
        export_options: name -> value; those of `TEXTURE_OPTIONS` are paths or None.
        source: file that the world was made from; None = unknown.
        place: on the earth; None = unknown.
    """

    name: str
    kind: str
    scale: str
    surface: HeightField
    spawn_poses: tuple[Pose2, ...] = ()
    spawn_for: str = ""
    start: Pose2 | None = None
    walls: WallGrid | None = None
    truth: OccupancyGrid | None = None
    solid: TriangleMesh | None = None
    overhangs: bool = False
    no_ground: BoolArray | None = None
    sample_spacing: float | None = None
    export_options: Mapping[str, Any] = field(default_factory=dict)
    source: str | None = None
    place: Place | None = None


def write_world(world: WorldFile, folder: Path) -> Path:
    """Write the world's two files into a folder and return it.

    Raises:
        OutputError: the folder cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {"surface": world.surface.z}
    entry: dict[str, Any] = {
        "schema": SCHEMA,
        "name": world.name,
        "kind": world.kind,
        "scale": world.scale,
        "source": world.source,
        "surface": {"cell": world.surface.cell, "origin": world.surface.origin},
        "starts": [astuple(pose) for pose in world.spawn_poses],
        "starts_for": world.spawn_for,
        "arrays": ARRAYS,
    }
    if world.start is not None:
        entry["start"] = astuple(world.start)
    if world.sample_spacing is not None:
        entry["sample_spacing"] = world.sample_spacing
    if world.place is not None:
        entry["place"] = asdict(world.place)
    if world.walls is not None:
        arrays["walls"] = world.walls.solid
        entry["walls"] = _grid_entry(world.walls) | {"height": world.walls.height}
        if world.walls.hole is not None:
            arrays["hole"] = world.walls.hole
    if world.truth is not None:
        arrays["truth"] = world.truth.log_odds
        entry["truth"] = _grid_entry(world.truth)
    if world.no_ground is not None:
        arrays["bare"] = world.no_ground
    if world.solid is not None:
        arrays |= {"vertices": world.solid.vertices, "faces": world.solid.faces}
        entry["overhangs"] = world.overhangs
    entry["finish"] = dict(world.export_options) | _kept_textures(world, folder)
    with atomic_write(folder / ARRAYS) as path:
        _write_arrays(path, arrays)
    with atomic_write(folder / JSON) as path:
        path.write_text(json.dumps(entry, indent=1) + "\n", encoding="utf-8")
    return folder


def recorded_source(folder: Path) -> str | None:
    """Return the source of the world in a folder; None = unknown."""
    with checked_content(folder):
        source: str | None = json.loads((folder / JSON).read_text(encoding="utf-8")).get("source")
        return source


def _write_arrays(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write an .npz with compressed arrays.

    Heights stay uncompressed: compressing them is slow and hardly makes them smaller.
    """
    with zipfile.ZipFile(path, "w") as file:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_STORED if name == "surface" else zipfile.ZIP_DEFLATED
            with file.open(entry, "w", force_zip64=True) as data:
                np.lib.format.write_array(data, array, allow_pickle=False)


def read_world(folder: Path) -> WorldFile:
    """Read a world's two files.

    Raises:
        SourceError: a file is missing or damaged, or of another schema.
    """
    path = folder / JSON
    with checked_content(folder):
        entry = json.loads(path.read_text(encoding="utf-8"))
        if entry["schema"] != SCHEMA:
            raise SourceError(
                f"{path}: schema {entry['schema']} is not the one this version reads ({SCHEMA})"
            )
        with np.load(referenced_file(path, entry["arrays"]), allow_pickle=False) as arrays:
            cell = _pair(entry["surface"]["cell"])
            if not CELLS[0] <= min(cell) <= max(cell) <= CELLS[1]:
                raise ValueError(f"cell must be {CELLS[0]:g} to {CELLS[1]:g} m, got {cell}")
            surface = HeightField(arrays["surface"], cell, _pair(entry["surface"]["origin"]))
            walls, truth = entry.get("walls"), entry.get("truth")
            hole = arrays.get("hole")
            return WorldFile(
                name=entry["name"],
                kind=entry["kind"],
                scale=entry["scale"],
                surface=surface,
                spawn_poses=tuple(Pose2(*pose) for pose in entry["starts"]),
                spawn_for=str(entry.get("starts_for", "")),
                start=Pose2(*entry["start"]) if "start" in entry else None,
                walls=walls and WallGrid(arrays["walls"], *_grid_placement(walls), walls["height"], hole),
                truth=truth and OccupancyGrid(arrays["truth"], *_grid_placement(truth)),
                solid=TriangleMesh(arrays["vertices"], arrays["faces"]) if "faces" in arrays else None,
                overhangs=bool(entry.get("overhangs", False)),
                no_ground=arrays.get("bare"),
                sample_spacing=float(entry["sample_spacing"]) if "sample_spacing" in entry else None,
                export_options=_export_settings(entry, folder),
                source=entry.get("source"),
                place=_place(entry.get("place")),
            )


@contextmanager
def checked_content(folder: Path) -> Iterator[None]:
    """Convert errors from missing or damaged files of a world to SourceError."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise SourceError(f"{folder / JSON}: not a built world, or damaged: {reason_of(error)}") from error


def texture_path(name: str, role: str, given: Path | None) -> Path:
    """Return the path of a texture in a world's folder.

    Args:
        name: of the world.
        role: `texture` of the ground or `wall_texture`.
        given: the user's file; None = a generated texture.
    """
    stem = name if role == "texture" else f"{name}-walls"
    return TEXTURES / f"{stem}{given.suffix.lower() if given else '.png'}"


def _kept_textures(world: WorldFile, folder: Path) -> dict[str, str | None]:
    """Copy the user's textures into the folder; return their paths in it."""
    kept: dict[str, str | None] = {"texture": None}
    for role in TEXTURE_OPTIONS:
        given: Path | None = world.export_options.get(role)
        if given is not None:
            inside = texture_path(world.name, role, given)
            with atomic_write(folder / inside) as path:
                path.write_bytes(given.read_bytes())
            kept[role] = inside.as_posix()
    return kept


def _export_settings(entry: dict[str, Any], folder: Path) -> dict[str, Any]:
    given: dict[str, Any] = entry.get("finish", {})
    owner = folder / JSON
    return given | {role: referenced_file(owner, given[role]) for role in TEXTURE_OPTIONS if given.get(role)}


def _place(entry: dict[str, Any] | None) -> Place | None:
    if entry is None:
        return None
    system = entry["system"] | {"ellipsoid": _pair(entry["system"]["ellipsoid"])}
    a, b, c, d, e, f = map(float, entry["affine"])
    return Place(CoordinateSystem(**system), (a, b, c, d, e, f), entry["height"])


def _grid_entry(grid: WallGrid | OccupancyGrid) -> dict[str, Any]:
    return {"resolution": grid.resolution, "origin": astuple(grid.origin)}


def _grid_placement(entry: dict[str, Any]) -> tuple[float, Pose2]:
    return entry["resolution"], Pose2(*entry["origin"])


def _pair(values: list[float]) -> tuple[float, float]:
    return float(values[0]), float(values[1])
