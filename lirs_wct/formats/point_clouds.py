"""Files of point clouds: PLY, LAS, LAZ and PCD.

Headers are checked against the size of the file before a library allocates memory for the points.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.formats.limited import run_limited
from lirs_wct.formats.meshes.mesh_reader import ply_elements, require_positions, require_xyz
from lirs_wct.geometry.geodesy import CoordinateSystem, system_of_wkt

VERTICAL_UNITS = 4099
"""GeoKey of the vertical unit."""
METERS = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
"""Meters in a unit of length (EPSG): meter, foot, US survey foot."""
EXTRA = "pip install '.[clouds]'"
GROUND, NOISE = 2, (7, 18)
"""Classes of the ASPRS LAS specification 1.4, table 17."""


@dataclass(frozen=True)
class PointFile:
    """The points of a file.

    Attributes:
        xyz: (n, 3) float64 in units of the file's coordinates; finite.
        ground: (n,) whether the file classifies a point as ground; None without classes.
        system: coordinate system of x and y.
        height_unit: meters per unit of z.
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
    except Exception as error:  # every reader raises different errors
        raise SourceError(f"{path}: cannot be read as a point cloud: {reason_of(error)}") from error
    kept = np.isfinite(found.xyz).all(axis=1)
    if kept.sum() < 3:
        raise SourceError(f"{path}: holds {int(kept.sum())} points, a ground needs at least 3")
    ground = None if found.ground is None else found.ground[kept]
    return replace(found, xyz=found.xyz[kept], ground=ground)


def _read_ply(path: Path) -> PointFile:
    import trimesh  # imported here to keep the start of logs fast

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
    # The header does not bound the size of decompressed points.
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
    """Return coordinate system and meters per unit of z from WKT, else from GeoKeys."""
    for record in (*header.vlrs, *(header.evlrs or ())):
        text = getattr(record, "string", None)
        if record.record_id == 2112 and text:
            return system_of_wkt(text)
    for record in header.vlrs:
        if record.record_id == 34735:
            crs = record.parse_crs()
            system = CoordinateSystem() if crs is None else system_of_wkt(crs.to_wkt())[0]
            keys = {key.id: key.value_offset for key in record.geo_keys}
            return system, METERS.get(keys.get(VERTICAL_UNITS, 0), system.unit)
    return CoordinateSystem(), 1.0


def _require(path: Path, package: str) -> None:
    if find_spec(package) is None:
        raise SourceError(f"{path}: needs the package {package}: {EXTRA}")


LAS_BEGIN = b"LASF"
"""The first bytes of a LAS or LAZ file."""
_LAS_HEADER, _LAS_14_HEADER = 227, 375
"""Bytes of the public header of LAS 1.0 to 1.2, and of 1.4."""
_VLR, _EVLR = (54, 18, "<H"), (60, 18, "<Q")
"""Bytes of a record's header; position and format of the content's length in it."""
_COMPRESSED = 0x80
"""Bit of the point format that marks LAZ."""
_PCD_HEADER = 1 << 14
_LZF = 90
"""LZF writes at most 264 bytes for 3."""


def check_las(path: Path) -> bool:
    """Check a LAS file and return whether its points are compressed.

    The format is ASPRS LAS 1.4, section 2.

    Raises:
        SourceError: not a LAS file, or shorter than its header says.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_LAS_14_HEADER)
        if not head.startswith(LAS_BEGIN):
            begin = head[: len(LAS_BEGIN)]
            raise SourceError(
                f"{path}: is not a LAS file: it begins with {begin!r}, those with {LAS_BEGIN!r}"
            )
        if len(head) < _LAS_HEADER:
            raise SourceError(f"{path}: is cut off: a LAS header has {_LAS_HEADER} bytes, this file {size}")
        header, start, records = struct.unpack_from("<HII", head, 94)
        form, length, points = struct.unpack_from("<BHI", head, 104)
        if not _LAS_HEADER <= header <= start <= size:
            raise SourceError(
                f"{path}: is damaged: its header has {header} bytes and its points begin at byte {start}; "
                f"legal: {_LAS_HEADER} <= header <= begin <= {size}, the file's size"
            )
        _check_records(path, file, records, header, start, _VLR)
        if head[25] >= 4 and len(head) == _LAS_14_HEADER <= header:
            extended, count, points = struct.unpack_from("<QIQ", head, 235)
            if count:
                _check_records(path, file, count, extended, size, _EVLR)
    compressed = bool(form & _COMPRESSED)
    if length == 0 or (not compressed and start + points * length > size):
        raise SourceError(
            f"{path}: is damaged or cut off: {points} points of {length} bytes from byte {start} on "
            f"are not in a file of {size}"
        )
    return compressed


def _check_records(
    path: Path, file: BinaryIO, count: int, begin: int, end: int, kind: tuple[int, int, str]
) -> None:
    """Raise SourceError unless `count` records of variable length fit between two bytes."""
    head, place, form = kind
    at = begin
    for _ in range(count if begin + count * head <= end else 0):
        file.seek(at)
        record = file.read(head)
        at += head + (struct.unpack_from(form, record, place + 2)[0] if len(record) == head else end)
        if at > end:
            break
    if begin + count * head > end or at > end:
        raise SourceError(
            f"{path}: is damaged: {count} records from byte {begin} on reach beyond byte {end}, their end"
        )


def check_pcd(path: Path) -> None:
    """Check that the points of a PCD file fit into it.

    Raises:
        SourceError: the file is shorter than its header says.
    """
    with path.open("rb") as file:
        head = file.read(_PCD_HEADER)
        entries, form, begin = _pcd_entries(head)
        file.seek(begin)
        packed = file.read(8)
    try:
        sizes, counts = ([int(n) for n in entries[key]] for key in (b"SIZE", b"COUNT"))
        points = int(entries[b"POINTS"][0])
    except (KeyError, ValueError, IndexError):
        return  # the reader reports the fault
    record, values = sum(n * k for n, k in zip(sizes, counts, strict=False)), sum(counts)
    size = path.stat().st_size
    left = size - begin
    if form == b"binary_compressed":
        need, unpacked = struct.unpack("<II", packed) if len(packed) == 8 else (size, 0)
        fits = need <= left - 8 and max(unpacked, points * record) <= _LZF * need
    else:
        fits = points * (record if form == b"binary" else values) <= left
    if values > size or (points != 0 and not (fits and points > 0 and record > 0)):
        raise SourceError(
            f"{path}: is damaged or cut off: {points} points of {record} bytes are not in a file of {size}"
        )


def _pcd_entries(head: bytes) -> tuple[dict[bytes, list[bytes]], bytes, int]:
    """Return header lines by first word, and the data's kind and start."""
    entries: dict[bytes, list[bytes]] = {}
    at = 0
    for line in head.splitlines(keepends=True):
        at += len(line)
        words = line.split()
        if words:
            entries[words[0].upper()] = words[1:]
            if words[0].upper() == b"DATA":
                break
    return entries, b"".join(entries.get(b"DATA", [])[:1]).lower(), at
