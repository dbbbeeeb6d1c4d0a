"""SRTM's height files (.hgt): a square degree of 16-bit heights, named by its south-west corner."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError
from lirs_wct.formats.images.geotiff import RasterInfo
from lirs_wct.formats.images.picture import check_size
from lirs_wct.geometry.geodesy.earth import CoordinateSystem
from lirs_wct.geometry.geodesy.georeference import Georeference

SHAPES = {rows * cols * 2: (rows, cols) for rows, cols in ((1201, 1201), (3601, 3601), (3601, 1801))}
"""Bytes of a file -> rows and columns: 3 and 1 arc seconds, and beyond 50 degrees 1 by 2."""
VOID = -32768.0
_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)


def read_hgt(path: Path, max_pixels: int) -> tuple[NDArray[np.int16], RasterInfo]:
    """Return (rows, cols) heights in meters, row 0 = north, and where they lie, which the file's name says.

    Raises:
        SourceError: the file is missing, of another length, or its name says no place.
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
