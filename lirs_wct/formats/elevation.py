"""Elevation data: ESRI ASCII grids, encoded map tiles, and the rasters of GDAL.

GDAL reads a damaged number of an ASCII grid as 0, so these grids have a reader here.
"""

from __future__ import annotations

import glob
import math
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.files import first_bytes, read_text
from lirs_wct.formats import Encoding, limited, picture
from lirs_wct.geometry.geodesy import (
    TURNED,
    WGS84,
    Affine,
    CoordinateSystem,
    Georeference,
    OutsideSystemError,
    middle_of_pixels,
    system_of_wkt,
)

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


@dataclass(frozen=True, slots=True)
class RasterInfo:
    """Georeference and value conversion of a raster.

    Attributes:
        nodata: Value of pixels without height, which may be NaN; None = not declared.
        scale: height = scale value + offset, in units of height.
        unit: Meters per unit of height; None if the values are not heights.
    """

    georeference: Georeference | None = None
    nodata: float | None = None
    scale: float = 1.0
    offset: float = 0.0
    unit: float | None = None


@dataclass(frozen=True, slots=True)
class Raster:
    """Pixels (rows, cols) gray or (rows, cols, 3) BGR that hold or encode heights; row 0 is north."""

    pixels: NDArray[Any]
    info: RasterInfo = field(default_factory=RasterInfo)


def read_raster(path: Path, max_pixels: int = picture.MAX_PIXELS, *, sized: bool = False) -> Raster:
    """Read the raster of a file by its content; with `sized`, the caller knows the extent."""
    head = first_bytes(path)
    pixels: NDArray[Any]
    if _ASCII_GRID.match(head):
        pixels, info = read_ascii_grid(path, max_pixels, sized=sized)
    elif _PICTURE.match(head):
        pixels = picture.read_picture(path, max_pixels).pixels
        beside = path.with_name(f"{path.name}.aux.xml").is_file()
        info = _info(path, limited.read_gdal(path, 0) if beside else None, pixels, sized)
    else:
        pixels, info = _read_by_gdal(path, max_pixels, sized)
    if info.georeference is None:
        return Raster(pixels, info)
    pixels, georeference = info.georeference.upright(pixels)
    if abs(math.sin(math.radians(georeference.turn))) > TURNED:
        warnings.warn(
            f"{path}: is turned by {georeference.turn:.4g} deg; x of the world goes along its rows, "
            f"{georeference.heading:.4g} deg north of east",
            stacklevel=2,
        )
    if georeference.skewed:
        warnings.warn(f"{path}: is skewed, which is left out; gdalwarp straightens it", stacklevel=2)
    return Raster(pixels, replace(info, georeference=georeference))


HINTS = {
    ".hgt": ". An HGT file is named by its south-west corner, like N40W074.hgt.",
    ".xyz": ". Scattered points are read from .las, .pcd or .ply: pdal translate IN.xyz OUT.las",
}
_ASCII_GRID = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:ncols|nrows|[xy]llc\w+|cellsize|d[xy])\s", re.I)
_PICTURE = re.compile(rb"\x89PNG|P[1-6fF]\s|GIF8|\xff\xd8\xff|BM|RIFF....WEBP", re.DOTALL)


def _world_file(path: Path) -> Affine | None:
    """Return the six numbers of a world file beside a picture; None without one."""
    suffix = path.suffix.lower()
    endings = (f"{suffix[:2]}{suffix[-1:]}w", f"{suffix}w", ".wld")
    for beside in path.parent.glob(f"{glob.escape(path.stem)}.*"):
        if beside.suffix.lower() in endings:
            try:
                a, d, b, e, c, f = map(float, first_bytes(beside, 1024).replace(b",", b".").split())
            except ValueError as error:
                raise SourceError(f"{beside}: is damaged: a world file holds six numbers") from error
            return a, b, c, d, e, f
    return None


def _read_by_gdal(path: Path, max_pixels: int, sized: bool) -> tuple[NDArray[Any], RasterInfo]:
    """Read a raster and its metadata through GDAL."""
    try:
        raster = limited.read_gdal(path, max_pixels)
    except SourceError as error:
        raise SourceError(f"{error}{HINTS.get(path.suffix.lower(), '')}") from error
    picture.check_size(path, raster.width, raster.height, max_pixels)
    pixels = picture.without_alpha(path, picture.pixels_of(path, raster))
    if pixels.dtype.kind == "c":
        raise SourceError(f"{path}: holds complex numbers, heights must be integers or real numbers")
    return pixels, _info(path, raster, pixels, sized)


def _info(path: Path, raster: limited.GdalRaster | None, pixels: NDArray[Any], sized: bool) -> RasterInfo:
    """Return georeference and value conversion of a raster from GDAL's metadata, or a world file."""
    info = RasterInfo() if raster is None else RasterInfo(None, raster.nodata, raster.scale, raster.offset)
    affine = middle_of_pixels(raster.transform) if raster and raster.transform else _world_file(path)
    if affine is None:
        return info
    system, unit = system_of_wkt(raster.wkt) if raster and raster.wkt else (None, None)
    if name := raster.unit.strip() if raster else "":
        american = re.sub("tre(s?)$", r"ter\1", name.lower())
        unit = next((meters for meters, names in UNITS.items() if american in names), None)
        if unit is None:
            warnings.warn(f"{path}: its values are in {name!r}, which is taken for meters", stacklevel=4)
            unit = 1.0
    info = replace(info, unit=height_unit(path, system or CoordinateSystem(), unit))
    return replace(info, georeference=_georeference(path, system, affine, pixels, info, sized))


def height_unit(path: Path, system: CoordinateSystem, vertical: float | None) -> float:
    """Return meters per unit of height, by default that of the plane; warn of feet."""
    if vertical is None and system.unit != 1.0:
        warnings.warn(
            f"{path}: its plane is in units of {system.unit:.7g} m (feet: 0.3048), and its heights have no "
            f"unit: they are taken for the same; if they are meters, give --z-scale {1 / system.unit:.7g}",
            stacklevel=3,
        )
    return system.unit if vertical is None else vertical


def _georeference(
    path: Path,
    system: CoordinateSystem | None,
    affine: Affine,
    pixels: NDArray[Any],
    info: RasterInfo,
    sized: bool,
) -> Georeference | None:
    """Return the georeference of (rows, cols) pixels; None where only the caller knows the extent."""
    sizes = math.hypot(affine[0], affine[3]), math.hypot(affine[1], affine[4])
    if not all(0 < size < math.inf for size in sizes):
        raise SourceError(f"{path}: pixels must be above 0, got {sizes[0]:g} x {sizes[1]:g}")
    if not all(map(math.isfinite, affine)):
        raise SourceError(f"{path}: its corner must be finite, got {affine[2]:g}, {affine[5]:g}")
    shape = pixels.shape[0], pixels.shape[1]
    if system is not None:
        return georeference_raster(path, system, affine, shape)
    degrees = _are_degrees(affine, shape, _relief(pixels, info))
    if degrees is None:
        if sized:
            return None
        raise SourceError(
            f"{path}: names no coordinate system; its pixels of {sizes[0]:.6g} may be degrees or meters: "
            "give --resolution METERS, or the system (gdal_edit -a_srs EPSG:4326)"
        )
    if not degrees:
        return Georeference.on_grid(CoordinateSystem(), affine)
    warnings.warn(f"{path}: names no coordinate system, its coordinates are taken for degrees", stacklevel=2)
    return georeference_raster(path, CoordinateSystem.of_code(4326), affine, shape)


def _relief(pixels: NDArray[Any], info: RasterInfo) -> float:
    """Return the range of heights in a raster, meters."""
    if pixels.ndim != 2:
        return 0.0
    heights = pixels.astype(np.float64)
    missing, _ = missing_heights(heights, info.nodata, search=True)
    known = heights[~missing]
    return float(np.ptp(known)) * abs(info.scale) * (info.unit or 1.0) if known.size else 0.0


MIN_RELIEF, MAX_RELIEF = 1e-5, 3.0
"""Usual relief of a terrain, share of its width."""
MAX_DEGREE_PIXEL = 0.02
"""Size of a pixel below which degrees are as likely as meters."""
METERS_PER_DEGREE = 111_320.0
"""Meters of a degree at the equator."""


def _are_degrees(affine: Affine, shape: tuple[int, int], relief: float) -> bool | None:
    """Whether coordinates without a system are degrees; None where neither is the likely one.

    Coarse pixels are degrees only if their relief excludes meters. Fine ones are decided by the relief, then
    by their size: whole arc seconds, or thirds and ninths of one, against whole millimeters.
    """
    a, b, c, d, e, f = affine
    rows, cols = shape
    step = max(map(abs, (a, b, d, e)))
    x, y = (c, c + a * (cols - 1) + b * (rows - 1)), (f, f + d * (cols - 1) + e * (rows - 1))
    local = min(map(abs, x)) <= step and min(map(abs, y)) <= step
    if max(map(abs, x)) > 360 or max(map(abs, y)) > 90 + step or local:
        return False
    width = step * max(rows, cols)
    as_meters = MIN_RELIEF * width <= relief <= MAX_RELIEF * width
    as_degrees = MIN_RELIEF * width * METERS_PER_DEGREE <= relief <= MAX_RELIEF * width * METERS_PER_DEGREE
    seconds, millimeters = (
        number > 0.5 and abs(number - round(number)) < 1e-4 * number
        for number in (step * 3600 * 9, step * 1000)
    )
    if step >= MAX_DEGREE_PIXEL:
        return as_degrees and not as_meters and seconds
    if as_degrees != as_meters:
        return as_degrees
    return seconds if seconds != millimeters else None


def georeference_raster(
    path: Path, system: CoordinateSystem, affine: Affine, shape: tuple[int, int]
) -> Georeference:
    """Return the georeference of (rows, cols) pixels in a coordinate system.

    Without one, its units count as ground meters; likewise, with a warning, where PROJ does not know it.
    """
    if system.form == "unknown":
        return Georeference.on_grid(system, affine)
    try:
        return Georeference.of(system, affine, shape)
    except ConfigError as error:
        if system.form != "other" or isinstance(error, OutsideSystemError):
            raise SourceError(f"{path}: {error}") from error
        warnings.warn(f"{path}: its units are taken for ground meters: {error}", stacklevel=2)
        return Georeference.on_grid(system, affine)


_KEY = re.compile("ncols|nrows|[xy]ll(corner|center)|cellsize|d[xy]|nodata_value", re.I)


def read_ascii_grid(path: Path, max_pixels: int, *, sized: bool) -> tuple[FloatArray, RasterInfo]:
    """Read (rows, cols) heights of an ESRI ASCII grid and their metadata; row 0 is north."""
    try:
        lines = iter(read_text(path).splitlines())
        header, first = _header(path, lines)
        rows, cols = int(header["nrows"]), int(header["ncols"])
        picture.check_size(path, cols, rows, max_pixels)
        values = np.array([*first.split(), *" ".join(lines).split()], dtype=np.float64)
    except ValueError as error:
        raise SourceError(f"{path}: holds a value that is no number: {error}") from error
    if values.size != rows * cols:
        raise SourceError(f"{path}: holds {values.size} heights, {cols} x {rows} are announced")
    pixels = values.reshape(rows, cols)
    dx, dy = (header.get(axis, header.get("cellsize", 0.0)) for axis in ("dx", "dy"))
    if not (0 < dx < np.inf and 0 < dy < np.inf):
        raise SourceError(f"{path}: cells must be above 0, got {dx:g} x {dy:g}")
    west = header["xllcenter"] if "xllcenter" in header else header["xllcorner"] + dx / 2
    south = header["yllcenter"] if "yllcenter" in header else header["yllcorner"] + dy / 2
    affine = dx, 0.0, west, 0.0, -dy, south + dy * (rows - 1)
    system, unit = _projection(path)
    unit = height_unit(path, system or CoordinateSystem(), unit)
    info = RasterInfo(None, header.get("nodata_value"), unit=unit)
    georeference = _georeference(path, system, affine, pixels, info, sized)
    return pixels, replace(info, georeference=georeference)


def _projection(path: Path) -> tuple[CoordinateSystem | None, float | None]:
    """Return the system and unit of height of a grid's .prj file; None without one."""
    projection = path.with_suffix(".prj")
    wkt = projection.read_text(encoding="utf-8", errors="replace").strip() if projection.is_file() else ""
    if wkt and "[" not in wkt:  # keywords of ArcInfo, which GDAL knows
        wkt = limited.read_gdal(path, 0).wkt
    try:
        return system_of_wkt(wkt) if wkt else (None, None)
    except ConfigError as error:  # without PROJ
        raise SourceError(f"{projection}: {error}") from error


def _header(path: Path, lines: Iterable[str]) -> tuple[dict[str, float], str]:
    """Return the header's values by lower-case name, and the first line after it."""
    header: dict[str, float] = {}
    first = ""
    for line in lines:
        key, *value = line.split() or [""]
        if not _KEY.fullmatch(key):
            first = line
            break
        if len(value) != 1:
            raise SourceError(f"{path}: its line {line.strip()!r} has no single value")
        header[key.lower()] = float(value[0])
    missing = [key for key in ("ncols", "nrows") if key not in header]
    missing += [] if "cellsize" in header or {"dx", "dy"} <= set(header) else ["cellsize"]
    missing += [f"{a}llcorner" for a in "xy" if not {f"{a}llcorner", f"{a}llcenter"} & set(header)]
    if missing:
        raise SourceError(f"{path}: the header of an ASCII grid lacks {', '.join(missing)}")
    for key in ("ncols", "nrows"):
        if not (header[key] >= 1 and header[key].is_integer()):
            raise SourceError(f"{path}: {key} must be a whole number above 0, got {header[key]:g}")
    return header, first


_TILE = re.compile(r"(\d{1,2})/(\d+)/(\d+)(@2x)?")
_WORLD = 2 * math.pi * WGS84[0]
"""Meters of web Mercator around the world."""


def decode(pixels: NDArray[Any], encoding: Encoding) -> FloatArray:
    """Return (rows, cols) meters of (rows, cols, 3 or more) 8-bit BGR pixels.

    Terrain-RGB: -10000 + 0.1 (65536 R + 256 G + B), Mapbox's documentation of Terrain-RGB. Terrarium:
    256 R + G + B / 256 - 32768, documentation of Mapzen's (Tilezen's) terrain tiles.
    """
    blue, green, red = (pixels[..., k].astype(np.float64) for k in range(3))
    if encoding == "terrain-rgb":
        return np.asarray(-10000.0 + 0.1 * (65536.0 * red + 256.0 * green + blue))
    return np.asarray(256.0 * red + green + blue / 256.0 - 32768.0)


def tile_georeference(path: Path, shape: tuple[int, int]) -> Georeference | None:
    """Return the georeference of a tile stored as .../z/x/y.png; None for other names."""
    named = _TILE.fullmatch("/".join((*path.resolve().parts[-3:-1], path.stem)))
    if named is None:
        return None
    zoom, column, row = (int(named[k]) for k in (1, 2, 3))
    if zoom > 24 or max(column, row) >= 2**zoom:
        return None
    side = _WORLD / 2**zoom
    sx, sy = side / shape[1], side / shape[0]
    west, north = column * side - _WORLD / 2, _WORLD / 2 - row * side
    affine = (sx, 0.0, west + sx / 2, 0.0, -sy, north - sy / 2)
    try:
        return Georeference.of(CoordinateSystem.of_code(3857), affine, shape)
    except ConfigError as error:  # without PROJ
        raise SourceError(f"{path}: {error}") from error


NODATA_VALUES = (-9999.0, -32768.0)
"""Values of unmeasured pixels even where they are not isolated; values beyond `MAX_VALUE` likewise."""
MAX_VALUE = 1e30
NO_HEIGHTS = (999, 9999, 9999.9, 10_000, 32_767, 65_535, 99_999, 1e5, 999_999, 1e6, 2.0**31 - 1, 2.0**32 - 1)
"""Magnitudes of further values that mean "no height" where they are far outside all others."""
MAX_HEIGHT = 1e7
"""Magnitude of heights in any unit; isolated values above it mean "no height" as well."""
MIN_ISOLATION = 0.1
"""Distance of such a code from all other heights, share of their range."""


def missing_heights(
    values: NDArray[Any], nodata: float | None, *, search: bool
) -> tuple[BoolArray, tuple[float, ...]]:
    """Return the pixels without a height, and the isolated codes among their values, if searched."""
    missing = ~np.isfinite(values) | (np.abs(values) > MAX_VALUE)
    for value in (*NODATA_VALUES, *(() if nodata is None else (np.float64(nodata).astype(values.dtype),))):
        missing |= values == value
    codes: list[float] = []
    while search and (code := _isolated_code(values[~missing])) is not None:
        missing |= values == code
        codes.append(code)
    return missing, tuple(codes)


def _isolated_code(known: NDArray[Any]) -> float | None:
    """Return the lowest or highest height if it is a code far from all others."""
    for edge in (float(known.min()), float(known.max())) if known.size else ():
        if abs(edge) > MAX_HEIGHT or any(abs(abs(edge) - code) <= 1e-6 * code for code in NO_HEIGHTS):
            rest = known[known != edge]
            if rest.size and np.abs(rest - edge).min() > MIN_ISOLATION * np.ptp(rest):
                return edge
    return None
