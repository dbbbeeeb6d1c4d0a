"""Tags of TIFF and GeoTIFF: what the decoder does not report (scale, nodata, pages, truncation).

Layouts: TIFF 6.0, section 2; BigTIFF; OGC GeoTIFF 1.1 (19-008r4), annexes B and C.
"""

from __future__ import annotations

import math
import mmap
import struct

TagValue = tuple[float, ...] | bytes
Tags = dict[int, TagValue]

WIDTH, HEIGHT, SAMPLES = 256, 257, 277
EXTENTS = ((273, 279), (324, 325))
"""Tags of offsets and byte counts: of strips, of tiles."""
PIXEL_SCALE, TIEPOINT, TRANSFORMATION = 33550, 33922, 34264
GEO_KEYS, GEO_DOUBLES, GDAL_NODATA = 34735, 34736, 42113
MODEL_TYPE, SEMI_MAJOR_AXIS, INVERSE_FLATTENING, LINEAR_UNITS, VERTICAL_UNITS = 1024, 2057, 2059, 3076, 4099
GEOGRAPHIC = 2
METRES = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
"""Metres in a unit of length (EPSG): metre, foot, US survey foot."""
_TYPES = {1: "B", 2: "s", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 11: "f", 12: "d", 16: "Q", 17: "q", 18: "Q"}


def read_tags(data: mmap.mmap) -> tuple[Tags, int]:
    """Return the first page's tags and the number of pages.

    Args:
        data: the whole file.

    Raises:
        ValueError: the file ends inside its directory or its pixels.
        struct.error: likewise.
    """
    order = "<" if data[:2] == b"II" else ">"
    big = struct.unpack(order + "H", data[2:4])[0] == 43
    (offset,) = struct.unpack(order + ("Q" if big else "I"), data[8:16] if big else data[4:8])
    tags, following = _directory(data, offset, order, big)
    seen = {offset}
    while following and following not in seen and len(seen) < 1000:
        seen.add(following)
        following = _directory(data, following, order, big, values=False)[1]
    for offsets, counts in EXTENTS:
        ends = [a + n for a, n in zip(tags.get(offsets, ()), tags.get(counts, ()), strict=False)]
        if ends and max(ends) > len(data):
            raise ValueError(f"is truncated: {max(ends):.0f} bytes of pixels announced, {len(data)} there")
    return tags, len(seen)


def _directory(data: mmap.mmap, offset: int, order: str, big: bool, values: bool = True) -> tuple[Tags, int]:
    """Return the tags of one directory and the offset of the next."""
    count_type, head, entry, inline, pointer = ("Q", 8, 20, 8, "Q") if big else ("H", 2, 12, 4, "I")
    (n,) = struct.unpack(order + count_type, data[offset : offset + head])
    start = offset + head
    end = start + n * entry
    (following,) = struct.unpack(order + pointer, data[end : end + inline])
    tags: Tags = {}
    for at in range(start, end if values else start, entry):
        tag, kind, count = struct.unpack(order + "HH" + pointer, data[at : at + entry - inline])
        if kind not in _TYPES:
            continue
        layout = f"{order}{count}{_TYPES[kind]}"
        size = struct.calcsize(layout)
        where = at + entry - inline
        if size > inline:
            (where,) = struct.unpack(order + pointer, data[where : where + inline])
        value = struct.unpack(layout, data[where : where + size])
        tags[tag] = value[0].rstrip(b"\0") if kind == 2 else value
    return tags, following


def metric_pixel(tags: Tags) -> tuple[float, float] | None:
    """Return the pixel's width and height in metres, or None where the file has no scale of its own.

    Degrees become metres at the latitude of the picture's centre, on the file's own ellipsoid. A
    rotation of the raster is left out: the picture's top row is north.

    Raises:
        ValueError: the scale is not finite and above 0.
    """
    if PIXEL_SCALE in tags:
        sx, sy = _floats(tags, PIXEL_SCALE)[:2]
    elif TRANSFORMATION in tags:
        m = _floats(tags, TRANSFORMATION)
        sx, sy = math.hypot(m[0], m[4]), math.hypot(m[1], m[5])
    else:
        return None
    if not (0 < sx < math.inf and 0 < sy < math.inf):
        raise ValueError(f"GeoTIFF pixel scale must be above 0, got {sx} x {sy}")
    keys = geo_keys(tags)
    if keys.get(MODEL_TYPE) == GEOGRAPHIC:
        east, north = metres_per_degree(_center_latitude(tags, sy), keys)
        return sx * east, sy * north
    unit = METRES.get(int(keys.get(LINEAR_UNITS, 9001)), 1.0)
    return sx * unit, sy * unit


def height_unit(tags: Tags) -> float:
    """Return the metres in a unit of the heights (1 unless the file says feet)."""
    return METRES.get(int(geo_keys(tags).get(VERTICAL_UNITS, 9001)), 1.0)


def nodata(tags: Tags) -> float | None:
    """Return the value that GDAL marked as "no data", which may be NaN, or None."""
    text = tags.get(GDAL_NODATA)
    try:
        return float(text) if isinstance(text, bytes) else None
    except ValueError:
        return None


def geo_keys(tags: Tags) -> dict[int, float]:
    """Return the numeric GeoKeys."""
    directory, doubles = _floats(tags, GEO_KEYS), _floats(tags, GEO_DOUBLES)
    keys: dict[int, float] = {}
    for i in range(4, len(directory) - 3, 4):
        key, location, _, value = map(int, directory[i : i + 4])
        if location == 0:
            keys[key] = value
        elif location == GEO_DOUBLES and value < len(doubles):
            keys[key] = doubles[value]
    return keys


def metres_per_degree(latitude: float, keys: dict[int, float]) -> tuple[float, float]:
    """Return metres in a degree eastward and northward on an ellipsoid (WGS 84 unless the keys say).

    Radii of curvature in the prime vertical and the meridian: Snyder 1987, eqs. 4-20 and 4-19.

    Args:
        latitude: degrees.
        keys: GeoKeys.
    """
    a = keys.get(SEMI_MAJOR_AXIS, 6378137.0)
    inverse = keys.get(INVERSE_FLATTENING, 298.257223563)
    f = 1 / inverse if inverse else 0.0
    e2, phi = f * (2 - f), math.radians(latitude)
    w = math.sqrt(1 - e2 * math.sin(phi) ** 2)
    east, north = a / w * math.cos(phi), a * (1 - e2) / w**3
    if not east > 0:
        raise ValueError(f"GeoTIFF centre lies at latitude {latitude:g}, degrees have no width there")
    return math.radians(east), math.radians(north)


def _center_latitude(tags: Tags, sy: float) -> float:
    rows, cols = _floats(tags, HEIGHT)[0], _floats(tags, WIDTH)[0]
    if PIXEL_SCALE not in tags:
        m = _floats(tags, TRANSFORMATION)
        return m[4] * cols / 2 + m[5] * rows / 2 + m[7]
    tie = _floats(tags, TIEPOINT)
    if len(tie) < 6:
        raise ValueError("GeoTIFF has a pixel scale in degrees but no tie point: its latitude is unknown")
    return tie[4] - (rows / 2 - tie[1]) * sy


def _floats(tags: Tags, tag: int) -> tuple[float, ...]:
    value = tags.get(tag, ())
    return () if isinstance(value, bytes) else value
