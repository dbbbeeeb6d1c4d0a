"""What elevation data bring beside a picture's pixels: heights in colors, meters, a place."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.elevation import Raster, decode, guess, tile_georeference
from lirs_wct.formats.images.geotiff import RasterInfo
from lirs_wct.geometry.geodesy import Place
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.sources.options import BuildOptions

STEEPER = 0.01
"""Share by which slopes may change before an extent without heights is worth a word."""


def decoded(path: Path, raster: Raster, options: BuildOptions) -> Raster:
    """Return the raster with heights instead of colors that encode them.

    Raises:
        SourceError: it holds no such colors.
        ConfigError: nothing says how large it is.
    """
    if options.encoding == "gray":
        return raster
    if raster.pixels.ndim != 3 or raster.pixels.dtype != np.uint8:
        raise SourceError(f"{path}: {options.encoding} is 8-bit color, this is {raster.pixels.dtype} gray")
    shape = raster.pixels.shape[:2]
    georeference = raster.info.georeference or tile_georeference(path, (shape[0], shape[1]))
    if georeference is None and options.size is None and options.pixel_size is None:
        raise ConfigError(
            f"{path}: its heights are in meters, its extent is not known: give --pixel-size or --size"
        )
    return Raster(decode(raster.pixels, options.encoding), RasterInfo(georeference, unit=1.0))


def way_out(pixels: NDArray[Any]) -> str:
    """Return what to say of a picture in color."""
    encoding = guess(pixels)
    if encoding is None:
        return "--grayscale makes it gray"
    meters = decode(pixels, encoding)
    return (
        f"its colors look like heights of {meters.min():.0f} to {meters.max():.0f} m: give "
        f"--encoding {encoding} (--grayscale would make it gray)"
    )


def pixel_of(info: RasterInfo) -> tuple[float, float] | None:
    """Return the ground meters of a pixel eastward and northward; None where the raster says none."""
    return None if info.georeference is None else info.georeference.pixel


def place_of(
    raster: Raster, surface: HeightField, height: float | None, options: BuildOptions
) -> Place | None:
    """Return where the terrain lies, if the raster says so."""
    found = raster.info.georeference
    if found is None or not found.located:
        return None
    left, top, cols, rows = options.crop or (0, 0, *raster.pixels.shape[1::-1])
    (west, south), (width, depth) = surface.origin, surface.size
    across, down = (cols - 1) / width, (rows - 1) / depth
    a, b, _, d, e, _ = found.affine
    # The column at x = 0, and the row at y = 0, of the whole raster.
    x0, y0 = found.coordinates(left - west * across, top + (south + depth) * down)
    return Place(found.system, (a * across, -b * down, x0, d * across, -e * down, y0), height)


def tell_slopes(path: Path, raster: Raster, surface: HeightField, options: BuildOptions) -> None:
    """Warn where the extent was given and the heights were not: slopes become others."""
    pixel = pixel_of(raster.info)
    if pixel is None or options.height or options.z_scale or options.scale:
        return
    cols = options.crop[2] if options.crop else raster.pixels.shape[1]
    steeper = (cols - 1) * pixel[0] / surface.size[0]
    if abs(steeper - 1) > STEEPER:
        warnings.warn(
            f"{path}: slopes become {steeper:.4g} times as steep: the extent was given, the heights stay the "
            f"file's own ({surface.relief:.4g} m); --height or --scale changes them as well",
            stacklevel=4,
        )
