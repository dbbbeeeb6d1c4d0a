"""Files of point clouds: PLY, LAS, LAZ and PCD."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import first_bytes
from lirs_wct.formats.limited import read_limited
from lirs_wct.formats.meshes.reader import MAX_COORDINATE, ply_header, read_ply
from lirs_wct.geometry.geodesy import CoordinateSystem, system_of_wkt

VERTICAL_UNITS = "4099"
"""GeoKey of the vertical unit."""
METERS = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
"""Meters in a unit of length (EPSG): meter, foot, US survey foot."""
LAS = b"LASF"
"""The first bytes of a LAS or LAZ file."""
EXTRA = "pip install 'lirs-wct[clouds]'"


@dataclass(frozen=True)
class PointFile:
    """The points of a file.

    Attributes:
        xyz: (n, 3) float64 in units of the file's coordinates; finite.
        ground: (n,) Whether the file classifies a point as ground; None without classes.
        height_unit: Meters per unit of z; None = not stated.
    """

    xyz: FloatArray
    ground: BoolArray | None = None
    system: CoordinateSystem = CoordinateSystem()  # noqa: RUF009  a frozen value
    height_unit: float | None = None


def is_cloud_ply(path: Path) -> bool:
    """Return whether a PLY file holds points and no faces."""
    try:
        with path.open("rb") as file:
            _, elements = ply_header(file.read(1 << 16))
    except (OSError, ValueError, LookupError):  # the reader of meshes reports the fault
        return False
    return not any(element.rows for element in elements if element.name in ("face", "tristrips"))


def read_points(path: Path) -> PointFile:
    """Read a point cloud."""
    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    try:
        if path.suffix.lower() == ".ply":
            cloud = PointFile(read_ply(path.read_bytes()).whole.vertices)
        else:
            cloud = _read_limited(path)
    except SourceError:
        raise
    except Exception as error:  # every reader raises different errors
        raise SourceError(f"{path}: cannot be read as a point cloud: {reason_of(error)}") from error
    kept = np.isfinite(cloud.xyz).all(axis=1)
    if kept.sum() < 3:
        raise SourceError(f"{path}: holds {int(kept.sum())} points, a ground needs at least 3")
    if not (np.abs(cloud.xyz[kept]) <= MAX_COORDINATE).all():
        raise SourceError(f"{path}: has points farther than {MAX_COORDINATE:g} units")
    ground = None if cloud.ground is None else cloud.ground[kept]
    return replace(cloud, xyz=cloud.xyz[kept], ground=ground)


def _read_limited(path: Path) -> PointFile:
    """Read a LAS, LAZ or PCD file, whose header does not bound its points."""
    begin = first_bytes(path, 4)
    las = begin == LAS
    if not las and path.suffix.lower() != ".pcd":
        raise SourceError(f"{path}: is not a LAS file: it begins with {begin!r}, a LAS file with {LAS!r}")
    for package in ("laspy", "lazrs", "pyproj") if las else ("pypcd4",):
        if find_spec(package) is None:
            raise SourceError(f"{path}: needs the package {package}: {EXTRA}")
    values, (xyz, *ground) = read_limited("las" if las else "pcd", path)
    wkt, vertical = values.get("wkt"), METERS.get(values.get("keys", {}).get(VERTICAL_UNITS, 0))
    system, unit = system_of_wkt(wkt) if wkt else (CoordinateSystem(), None)
    return PointFile(xyz, ground[0] if ground and ground[0].any() else None, system, vertical or unit)
