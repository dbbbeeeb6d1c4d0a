"""Elevation data: GeoTIFF, ESRI ASCII grids, SRTM's HGT, encoded map tiles; all others through GDAL."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TextIO

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.images.gdal import DRIVERS, read_gdal
from lirs_wct.formats.images.geotiff import (
    DEGREES,
    RasterInfo,
    georeference_raster,
    height_unit,
    looks_geographic,
    raster_info,
    tell_turn,
)
from lirs_wct.formats.images.header import MAX_PIXELS
from lirs_wct.formats.images.picture import check_size, read_picture
from lirs_wct.formats.suffixes import RASTERS
from lirs_wct.geometry.geodesy import (
    WGS84,
    Affine,
    CoordinateSystem,
    Georeference,
    middle_of_pixels,
    system_of_text,
)


@dataclass(frozen=True, slots=True)
class Raster:
    """Pixels that hold or encode heights; row 0 is the northernmost if that is known.

    Attributes:
        pixels: (rows, cols) gray or (rows, cols, 3) BGR, in the file's data type.
        info: georeference and units of the pixels.
    """

    pixels: NDArray[Any]
    info: RasterInfo = field(default_factory=RasterInfo)


def read_raster(path: Path, max_pixels: int = MAX_PIXELS) -> Raster:
    """Read the raster of a file.

    Raises:
        SourceError: the file is missing, damaged, of an unknown format, smaller than 2x2 or larger than
            `max_pixels`.
    """
    suffix = path.suffix.lower()
    pixels: NDArray[Any]
    if suffix == ".asc":
        pixels, info = read_ascii_grid(path, max_pixels)
    elif suffix == ".hgt":
        pixels, info = read_hgt(path, max_pixels)
    elif suffix in RASTERS:
        pixels, info = _read_by_gdal(path, max_pixels)
    else:
        picture = read_picture(path, max_pixels)
        pixels = picture.pixels
        info = raster_info(path, picture.tags) if picture.tags else RasterInfo()
    if pixels.dtype.kind == "c":
        raise SourceError(f"{path}: holds complex numbers, heights must be integers or real numbers")
    if info.georeference is None:
        return Raster(pixels, info)
    georeference = _by_proj(path, info.georeference, pixels.shape[:2])
    pixels, georeference = georeference.upright(pixels)
    tell_turn(path, georeference)
    return Raster(pixels, replace(info, georeference=georeference))


def _by_proj(path: Path, found: Georeference, shape: tuple[int, ...]) -> Georeference:
    """Locate a GeoTIFF with a user-defined coordinate system through GDAL."""
    if found.system.name or not found.located or path.suffix.lower() == ".asc":
        return found
    system = system_of(read_gdal(path, DRIVERS[".tif"], 0).crs)
    if system.form != "other":
        return found
    try:
        return Georeference.of(system, found.affine, (shape[0], shape[1]))
    except ConfigError:
        return replace(found, system=system)  # on another celestial body


def _read_by_gdal(path: Path, max_pixels: int) -> tuple[NDArray[Any], RasterInfo]:
    """Read the first band of a raster and its metadata through GDAL."""
    found = read_gdal(path, DRIVERS[path.suffix.lower()], max_pixels)
    check_size(path, found.width, found.height, max_pixels)
    assert found.pixels is not None
    info = RasterInfo(None, found.nodata, found.scale, found.offset, height_unit(path, found.unit))
    if found.transform is not None:
        affine = middle_of_pixels(found.transform)
        try:
            info = replace(
                info, georeference=georeference_raster(path, system_of(found.crs), affine, found.pixels.shape)
            )
        except ConfigError as error:
            raise SourceError(f"{path}: {error}") from error
    return found.pixels, info


def system_of(crs: Any) -> CoordinateSystem:
    """Convert rasterio's CRS to a coordinate system; None = unknown."""
    if crs is None:
        return CoordinateSystem()
    code = crs.to_epsg()
    unit = 1.0 if crs.is_geographic else float(crs.linear_units_factor[1])
    if code is not None:
        return CoordinateSystem.of_code(code, unit)
    return CoordinateSystem(crs.to_wkt(), "geographic" if crs.is_geographic else "other", unit)


_KEYS = (
    "ncols",
    "nrows",
    "xllcorner",
    "xllcenter",
    "yllcorner",
    "yllcenter",
    "cellsize",
    "dx",
    "dy",
    "nodata_value",
)


def read_ascii_grid(path: Path, max_pixels: int) -> tuple[FloatArray, RasterInfo]:
    """Read (rows, cols) heights of an ESRI ASCII grid and their metadata.

    Row 0 is north. The format has a header of six lines, then heights in rows from the north.

    Raises:
        SourceError: the file is missing or damaged, or of another size than is legal.
    """
    try:
        with path.open(encoding="utf-8-sig", errors="strict") as file:
            header, first = _header(path, file)
            rows, cols = int(header["nrows"]), int(header["ncols"])
            check_size(path, cols, rows, max_pixels)
            values = np.array([*first.split(), *file.read().split()], dtype=np.float64)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise SourceError(f"{path}: is no text, an ASCII grid is needed") from error
    except ValueError as error:
        raise SourceError(f"{path}: holds a value that is no number: {error}") from error
    if values.size != rows * cols:
        raise SourceError(f"{path}: holds {values.size} heights, {cols} x {rows} are announced")
    affine = _affine(path, header, rows)
    try:
        georeference = georeference_raster(path, _system(path, affine), affine, (rows, cols))
    except ConfigError as error:
        raise SourceError(f"{path}: {error}") from error
    nodata = header.get("nodata_value")
    return values.reshape(rows, cols), RasterInfo(georeference, nodata, unit=1.0)


def _header(path: Path, file: TextIO) -> tuple[dict[str, float], str]:
    """Return the header's values by lower-case name, and the first line after it."""
    header: dict[str, float] = {}
    first = ""
    for line in file:
        key, *value = line.split() or [""]
        if key.lower() not in _KEYS:
            first = line
            break
        if len(value) != 1:
            raise SourceError(f"{path}: its line {line.strip()!r} has no single value")
        header[key.lower()] = float(value[0])
    missing = [key for key in ("ncols", "nrows") if not header.get(key, 0) >= 1]
    missing += [] if "cellsize" in header or {"dx", "dy"} <= set(header) else ["cellsize"]
    missing += [f"{a}llcorner" for a in "xy" if not {f"{a}llcorner", f"{a}llcenter"} & set(header)]
    if missing:
        raise SourceError(f"{path}: the header of an ASCII grid lacks {', '.join(missing)}")
    return header, first


def _affine(path: Path, header: dict[str, float], rows: int) -> Affine:
    dx, dy = (header.get(axis, header.get("cellsize", 0.0)) for axis in ("dx", "dy"))
    if not (0 < dx < np.inf and 0 < dy < np.inf):
        raise SourceError(f"{path}: cells must be above 0, got {dx:g} x {dy:g}")
    west = header["xllcenter"] if "xllcenter" in header else header["xllcorner"] + dx / 2
    south = header["yllcenter"] if "yllcenter" in header else header["yllcorner"] + dy / 2
    return dx, 0.0, west, 0.0, -dy, south + dy * (rows - 1)


def _system(path: Path, affine: Affine) -> CoordinateSystem:
    """Return the system of a projection file next to the grid, else plausible degrees."""
    projection = path.with_suffix(".prj")
    if projection.is_file():
        return system_of_text(projection.read_text(encoding="utf-8", errors="replace"))
    if looks_geographic(affine):
        warnings.warn(f"{path}: {DEGREES}", stacklevel=2)
        return CoordinateSystem.of_code(4326)
    return CoordinateSystem()


SHAPES = {rows * cols * 2: (rows, cols) for rows, cols in ((1201, 1201), (3601, 3601), (3601, 1801))}
"""Bytes of a file -> rows and columns: 3 and 1 arc seconds, and beyond 50 degrees 1 by 2."""
VOID = -32768.0
_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)


def read_hgt(path: Path, max_pixels: int) -> tuple[NDArray[np.int16], RasterInfo]:
    """Read (rows, cols) heights of an SRTM file in meters and their metadata.

    Row 0 is north. A file holds 16-bit heights of a square degree; its name is that of the south-west corner.

    Raises:
        SourceError: the file is missing, of another length, or its name states no place.
    """
    named = _NAME.match(path.stem)
    if named is None:
        raise SourceError(f"{path}: an HGT file is named by its south-west corner, like N40W074.hgt")
    try:
        size = path.stat().st_size
        if size not in SHAPES:
            legal = ", ".join(f"{rows}x{cols}" for rows, cols in SHAPES.values())
            raise SourceError(f"{path}: has {size} bytes, legal are 16-bit heights of {legal}")
        rows, cols = SHAPES[size]
        check_size(path, cols, rows, max_pixels)
        heights = np.fromfile(path, ">i2").reshape(rows, cols).astype(np.int16)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    south = int(named[2]) * (1 if named[1].upper() == "N" else -1)
    west = int(named[4]) * (1 if named[3].upper() == "E" else -1)
    affine = (1 / (cols - 1), 0.0, float(west), 0.0, -1 / (rows - 1), south + 1.0)
    georeference = Georeference.of(CoordinateSystem.of_code(4326), affine, (rows, cols))
    return heights, RasterInfo(georeference, VOID, unit=1.0)


Encoding = Literal["gray", "terrain-rgb", "terrarium"]
ENCODINGS: tuple[Encoding, ...] = ("gray", "terrain-rgb", "terrarium")
LOWEST, HIGHEST = -11_500.0, 9_000.0
"""Heights on the earth, meters; colors that encode others belong to a photo."""
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


def guess(pixels: NDArray[Any]) -> Encoding | None:
    """Guess the encoding of heights in the colors of a picture; None for plain colors.

    Heights of the earth fill a hundredth of either encoding's range. Red, the largest digit, then hardly
    changes, green jumps where red changes, and blue, the smallest digit, is seldom constant.
    """
    if pixels.ndim != 3 or pixels.dtype != np.uint8:
        return None
    blue, green, red = (np.abs(np.diff(pixels[..., k].astype(np.int16), axis=1)) for k in range(3))
    jumps = green[red > 0]
    if np.median(blue) < 3 or (red > 0).mean() > 0.2 or (jumps.size and np.median(jumps) < 128):
        return None
    for encoding in ENCODINGS[1:]:
        meters = decode(pixels, encoding)
        if LOWEST <= meters.min() < meters.max() <= HIGHEST:
            return encoding
    return None


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
    return Georeference.of(CoordinateSystem.of_code(3857), affine, shape)
