"""Points of a file, with what it says of their ground and of their place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.errors import SourceError
from lirs_wct.formats.clouds.headers import check_las, check_pcd
from lirs_wct.formats.elevation.wkt import system_of_text, units_of_text
from lirs_wct.formats.images.geotiff import system_of_keys
from lirs_wct.formats.images.tiff import METERS
from lirs_wct.formats.limited import run_limited
from lirs_wct.formats.meshes.ply_header import ply_elements, require_positions, require_xyz
from lirs_wct.geometry.geodesy.earth import CoordinateSystem

VERTICAL_UNITS = 4099
"""GeoKey of the unit of z."""
EXTRA = "pip install 'lirs-wct[clouds]'"
GROUND, NOISE = 2, (7, 18)
"""Classes of the ASPRS LAS specification 1.4, table 17."""


@dataclass(frozen=True)
class PointFile:
    """The points of a file.

    Attributes:
        xyz: (n, 3) float64 in units of the file's coordinates; finite.
        ground: (n,) whether the file says that a point is on the ground; None where it says nothing.
        system: coordinate system of x and y.
        height_unit: meters a unit of z.
    """

    xyz: FloatArray
    ground: BoolArray | None = None
    system: CoordinateSystem = CoordinateSystem()  # noqa: RUF009  a frozen value
    height_unit: float = 1.0


def is_cloud_ply(path: Path) -> bool:
    """Return whether a PLY file holds points and no faces."""
    elements = ply_elements(path)
    return elements is not None and elements.get("face", (0, ()))[0] == 0


def read_points(path: Path) -> PointFile:
    """Read a point cloud.

    Raises:
        SourceError: the file is missing, damaged, holds no points, or needs a package that is not there.
    """
    readers = {".las": _read_las, ".laz": _read_las, ".pcd": _read_pcd}
    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    try:
        found = readers.get(path.suffix.lower(), _read_ply)(path)
    except SourceError:
        raise
    except Exception as error:  # every reader has errors of its own
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise SourceError(f"{path}: cannot be read as a point cloud: {reason}") from error
    kept = np.isfinite(found.xyz).all(axis=1)
    if kept.sum() < 3:
        raise SourceError(f"{path}: holds {int(kept.sum())} points, a ground needs at least 3")
    ground = None if found.ground is None else found.ground[kept]
    return replace(found, xyz=found.xyz[kept], ground=ground)


def _read_ply(path: Path) -> PointFile:
    import trimesh  # here: a log's first scan does not wait for it

    require_positions(path)
    # Points have no texture.
    loaded = trimesh.load(path, process=False, skip_materials=True)
    return PointFile(np.asarray(loaded.vertices, np.float64).reshape(-1, 3))


def _read_pcd(path: Path) -> PointFile:
    _require(path, "pypcd4")
    check_pcd(path)
    from pypcd4 import PointCloud

    loaded = PointCloud.from_path(path)
    require_xyz(path, loaded.fields)
    xyz = loaded.numpy(("x", "y", "z"))
    return PointFile(np.asarray(xyz, np.float64).reshape(-1, 3))


def _read_las(path: Path) -> PointFile:
    compressed = check_las(path)
    _require(path, "laspy")
    if not compressed:
        return _las_points(path)
    _require(path, "lazrs")
    # The header does not bound what compressed points unpack to.
    return run_limited(path, _las_points, path)


def _las_points(path: Path) -> PointFile:
    import laspy

    las = laspy.read(path)
    kind = np.asarray(las.classification)
    kept = ~np.isin(kind, NOISE)
    xyz = np.stack((las.x, las.y, las.z), axis=1).astype(np.float64)
    ground = kind == GROUND
    return PointFile(xyz[kept], ground[kept] if ground.any() else None, *_las_system(las.header))


def _las_system(header: Any) -> tuple[CoordinateSystem, float]:
    """Return the coordinate system of a LAS file and meters a unit of z: by WKT, else by GeoKeys."""
    for record in (*header.vlrs, *(header.evlrs or ())):
        text = getattr(record, "string", None)
        if record.record_id == 2112 and text:
            return system_of_text(text.strip("\0 ")), units_of_text(text)[1]
    for record in header.vlrs:
        if record.record_id == 34735:
            keys = {key.id: float(key.value_offset) for key in record.geo_keys if not key.tiff_tag_location}
            system = system_of_keys(keys)
            return system, METERS.get(int(keys.get(VERTICAL_UNITS, 0)), system.unit)
    return CoordinateSystem(), 1.0


def _require(path: Path, package: str) -> None:
    if find_spec(package) is None:
        raise SourceError(f"{path}: needs the package {package}: {EXTRA}")
