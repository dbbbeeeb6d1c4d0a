"""Rasters that GDAL reads, through rasterio; the driver follows the content."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lirs_wct.errors import SourceError
from lirs_wct.files import first_bytes
from lirs_wct.formats.limited import read_limited

REFERRING = b"<VRTDataset"
"""Mark of a VRT, which only refers to other files."""


@dataclass(frozen=True)
class GdalRaster:
    """Pixels of a raster and its metadata from GDAL.

    Attributes:
        width: columns of pixels.
        height: rows of pixels.
        bands: bands of the file without alpha.
        white: value of white.
        pages: pictures in the file.
        nodata: value of pixels without a height, or None.
        scale: factor of the pixels.
        offset: added to the scaled pixels.
        unit: name of the heights' unit, or empty.
        transform: of the pixels' corners, the six numbers in rasterio's order; None where it is not known.
        wkt: coordinate system as WKT; empty where it is not known.
        pixels: (rows, cols) of the first band, NaN where a mask hides them, or (rows, cols, 3 or 4) BGR(A) of
            colors; None if there are too many pixels.
    """

    width: int
    height: int
    bands: int
    white: float
    pages: int
    nodata: float | None
    scale: float
    offset: float
    unit: str
    transform: tuple[float, float, float, float, float, float] | None
    wkt: str
    pixels: NDArray[Any] | None


def read_gdal(path: Path, max_pixels: int) -> GdalRaster:
    """Read a raster; one of more than `max_pixels` is described without its pixels.

    Raises:
        SourceError: GDAL cannot read the file, or the file only refers to others.
    """
    if REFERRING in first_bytes(path, 1024):
        raise SourceError(f"{path}: is a VRT, which refers to other files: gdal_translate makes a TIFF of it")
    found, arrays = read_limited("raster", path, max_pixels)
    found["transform"] = found["transform"] and tuple(found["transform"])
    return GdalRaster(**found, pixels=arrays[0] if arrays else None)
