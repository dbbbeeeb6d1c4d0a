"""Meaning of a GeoTIFF's tags: georeference, and conversion of values to heights.

OGC GeoTIFF 1.1 (19-008r4); scale, offset and unit of a band as GDAL writes them (tag 42112).
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.images import tiff
from lirs_wct.geometry.geodesy import (
    TURNED,
    WGS84,
    Affine,
    CoordinateSystem,
    Georeference,
    OutsideSystemError,
    middle_of_pixels,
)

DEGREES = "names no coordinate system, its coordinates are taken for degrees"
UNITS = {
    1.0: ("m", "meter", "meters"),
    0.3048: ("ft", "foot", "feet", "international foot"),
    1200 / 3937: ("us survey foot", "us-ft", "ftus", "us_survey_foot", "us survey feet"),
    0.01: ("cm", "centimeter"),
    0.001: ("mm", "millimeter"),
    0.1: ("dm", "decimeter"),
    1000.0: ("km", "kilometer"),
}
"""Meters in a unit -> its names in lower case and American spelling."""
USER_DEFINED = 32767
VERTICAL_FEET = {6360: 1200 / 3937, 8228: 0.3048, 6358: 1200 / 3937}
"""EPSG codes of vertical systems in feet: NAVD88 height (ftUS), NAVD88 height (ft), NAVD88 depth (ftUS)."""
_ITEM = re.compile(rb"<Item\b([^>]*)>([^<]*)</Item>")
_ROLE, _SAMPLE = re.compile(rb'\brole="(\w+)"'), re.compile(rb'\bsample="(\d+)"')


@dataclass(frozen=True, slots=True)
class RasterInfo:
    """Georeference and value conversion of a raster.

    Attributes:
        georeference: of the pixels; None = unknown.
        nodata: value of pixels without height, which may be NaN; None = not declared.
        scale: height = scale value + offset, in units of height.
        offset: see scale.
        unit: meters per unit of height; None if the values are not heights.
    """

    georeference: Georeference | None = None
    nodata: float | None = None
    scale: float = 1.0
    offset: float = 0.0
    unit: float | None = None


def raster_info(path: Path, tags: tiff.Tags) -> RasterInfo:
    """Return georeference and value conversion from the tags of a TIFF.

    Raises:
        SourceError: the tags contradict each other.
    """
    try:
        georeference = _georeference(path, tags)
    except (ValueError, ConfigError) as error:
        raise SourceError(f"{path}: GeoTIFF: {error}") from error
    items = _items(tags)
    unit = None
    if georeference is not None:
        unit = height_unit(path, items.get("unittype", ""), tags)
    return RasterInfo(
        georeference,
        tiff.nodata(tags),
        float(items.get("scale") or 1.0),
        float(items.get("offset") or 0.0),
        unit,
    )


def height_unit(path: Path, name: str, tags: tiff.Tags | None = None) -> float:
    """Return meters per unit of height: by its name, else from the GeoKeys, else 1."""
    american = re.sub("tre(s?)$", r"ter\1", name.strip().lower())
    for meters, names in UNITS.items():
        if american in names:
            return meters
    if name.strip():
        warnings.warn(f"{path}: its values are in {name.strip()!r}, which is taken for meters", stacklevel=2)
        return 1.0
    keys = tiff.geo_keys(tags or {})
    if tiff.VERTICAL_UNITS in keys:
        return tiff.METERS.get(int(keys[tiff.VERTICAL_UNITS]), 1.0)
    return VERTICAL_FEET.get(int(keys.get(tiff.VERTICAL, 0)), 1.0)


def georeference_raster(
    path: Path, system: CoordinateSystem, affine: Affine, shape: tuple[int, int]
) -> Georeference:
    """Return the georeference of pixels.

    Without a required PROJ, units count as ground meters, with a warning.

    Raises:
        SourceError: the raster's middle is no place on the earth.
    """
    if system.form == "unknown":
        return Georeference.on_grid(system, affine)
    try:
        return Georeference.of(system, affine, shape)
    except OutsideSystemError as error:
        raise SourceError(f"{path}: {error}") from error
    except ConfigError as error:
        if system.form != "other":
            raise
        warnings.warn(f"{path}: its units are taken for ground meters: {error}", stacklevel=2)
        return Georeference.on_grid(system, affine)


def tell_turn(path: Path, georeference: Georeference) -> None:
    """Warn of a raster that is rotated or skewed in its coordinates."""
    if abs(math.sin(math.radians(georeference.turn))) > TURNED:
        warnings.warn(
            f"{path}: is turned by {georeference.turn:.4g} deg; x of the world goes along its rows, "
            f"{georeference.heading:.4g} deg north of east",
            stacklevel=2,
        )
    if georeference.skewed:
        warnings.warn(f"{path}: is skewed, which is left out; gdalwarp straightens it", stacklevel=2)


def _georeference(path: Path, tags: tiff.Tags) -> Georeference | None:
    keys = tiff.geo_keys(tags)
    found = affine_of(tags)
    if found is None:
        return None
    affine, known = found
    rows, cols = (int(tiff.floats(tags, tag)[0]) for tag in (tiff.HEIGHT, tiff.WIDTH))
    system = system_of_keys(keys)
    if system.form == "unknown" and known and looks_geographic(affine):
        warnings.warn(f"{path}: {DEGREES}", stacklevel=3)
        system = CoordinateSystem.of_code(4326)
    if not known:
        if system.form == "geographic":
            raise ValueError("has a pixel scale in degrees but no tie point: its latitude is unknown")
        return Georeference.on_grid(system, affine, located=False)
    return georeference_raster(path, system, affine, (rows, cols))


def affine_of(tags: tiff.Tags) -> tuple[Affine, bool] | None:
    """Return the affine map of pixel middles, and whether it includes the position.

    Raises:
        ValueError: the spacing is not finite and above 0.
    """
    area = tiff.geo_keys(tags).get(tiff.RASTER_TYPE, 1) != tiff.POINT
    if tiff.PIXEL_SCALE in tags:
        sx, sy = tiff.floats(tags, tiff.PIXEL_SCALE)[:2]
        tie = tiff.floats(tags, tiff.TIEPOINT)
        known = len(tie) >= 6
        u, v, _, x, y, _ = tie[:6] if known else (0.0,) * 6
        corner: Affine = (sx, 0.0, x - u * sx, 0.0, -sy, y + v * sy)
    elif len(m := tiff.floats(tags, tiff.TRANSFORMATION)) >= 8:
        corner, known = (m[0], m[1], m[3], m[4], m[5], m[7]), True
        sx, sy = math.hypot(m[0], m[4]), math.hypot(m[1], m[5])
    else:
        return None
    if not (0 < sx < math.inf and 0 < sy < math.inf):
        raise ValueError(f"pixel scale must be above 0, got {sx} x {sy}")
    return (middle_of_pixels(corner) if area else corner), known


def looks_geographic(affine: Affine) -> bool:
    """Whether coordinates are likely degrees: pixels below 1/50 unit, and on the globe."""
    a, b, c, d, e, f = affine
    return max(map(abs, (a, b, d, e))) < 0.02 and 0 < abs(c) <= 360 and 0 < abs(f) <= 90


def system_of_keys(keys: dict[int, float]) -> CoordinateSystem:
    """Return the coordinate system of the GeoKeys."""
    geographic, projected = (int(keys.get(key, 0)) for key in (tiff.GEODETIC, tiff.PROJECTED))
    unit = tiff.METERS.get(int(keys.get(tiff.LINEAR_UNITS, 9001)), 1.0)
    if keys.get(tiff.MODEL_TYPE) == tiff.GEOGRAPHIC:
        axis = keys.get(tiff.SEMI_MAJOR_AXIS, WGS84[0]), keys.get(tiff.INVERSE_FLATTENING, WGS84[1])
        name = f"EPSG:{geographic}" if 0 < geographic < USER_DEFINED else ""
        return CoordinateSystem(name, "geographic", 1.0, axis)
    if 0 < projected < USER_DEFINED:
        return CoordinateSystem.of_code(projected, unit)
    return CoordinateSystem("", "unknown", unit)


def _items(tags: tiff.Tags) -> dict[str, str]:
    """Return GDAL's metadata of the first band by role: scale, offset, unittype."""
    text = tags.get(tiff.GDAL_METADATA)
    found: dict[str, str] = {}
    for attributes, value in _ITEM.findall(text if isinstance(text, bytes) else b""):
        role, sample = _ROLE.search(attributes), _SAMPLE.search(attributes)
        if role and (sample is None or sample[1] == b"0"):
            found.setdefault(role[1].decode(), value.decode("utf-8", errors="replace"))
    return found
