"""ESRI ASCII grids (.asc): a header of six lines, then heights in rows from the north."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TextIO

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.elevation.wkt import system_of_text
from lirs_wct.formats.images.geotiff import DEGREES, RasterInfo, located, looks_geographic
from lirs_wct.formats.images.picture import check_size
from lirs_wct.geometry.geodesy.earth import CoordinateSystem
from lirs_wct.geometry.geodesy.georeference import Affine

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
    """Return (rows, cols) heights, row 0 = north, and what header and projection file say of them.

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
        raise SourceError(f"{path}: holds what is no number: {error}") from error
    if values.size != rows * cols:
        raise SourceError(f"{path}: holds {values.size} heights, {cols} x {rows} are announced")
    affine = _affine(path, header, rows)
    try:
        georeference = located(path, _system(path, affine), affine, (rows, cols))
    except ConfigError as error:
        raise SourceError(f"{path}: {error}") from error
    nodata = header.get("nodata_value")
    return values.reshape(rows, cols), RasterInfo(georeference, nodata, unit=1.0)


def _header(path: Path, file: TextIO) -> tuple[dict[str, float], str]:
    """Return the header's values by their names in lower case, and the first line after it."""
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
    """Return the coordinate system of a projection file beside the grid, else degrees where they fit."""
    projection = path.with_suffix(".prj")
    if projection.is_file():
        return system_of_text(projection.read_text(encoding="utf-8", errors="replace"))
    if looks_geographic(affine):
        warnings.warn(f"{path}: {DEGREES}", stacklevel=2)
        return CoordinateSystem.of_code(4326)
    return CoordinateSystem()
