"""A picture becomes a height field in metres."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lirs_wct.errors import SourceError
from lirs_wct.formats import tiff
from lirs_wct.formats.picture import read_picture
from lirs_wct.heightfield import HeightField
from lirs_wct.options import DEFAULT_HEIGHT, DEFAULT_SIZE, BuildOptions

GRAY_TOLERANCE = 2
"""Levels of 255 by which the channels of a gray picture may differ (rounding of colour conversions)."""
LUMA = (0.114, 0.587, 0.299)
"""Weights of blue, green, red (ITU-R BT.601)."""
UNTAGGED_NODATA = (-9999.0, -32768.0)
"""What elevation rasters hold where nothing was measured, even without a tag; below -1e30 likewise."""


def read_height_field(path: Path, options: BuildOptions) -> HeightField:
    """Read a picture as a terrain: bright is high, the lowest point is z = 0, the centre is the origin.

    A GeoTIFF keeps its own pixel size and heights unless the options say otherwise; any other picture
    is scaled to the options or their defaults. The pixels are the nodes.

    Raises:
        SourceError: the file cannot be used, is in colour without `grayscale`, or is more than half
            nodata.
    """
    picture = read_picture(path, options.max_pixels)
    values = _fill(path, _gray(path, picture.pixels, options.grayscale), tiff.nodata(picture.tags))
    try:
        pixel = tiff.metric_pixel(picture.tags)
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error
    unit = None if pixel is None else tiff.height_unit(picture.tags)
    z = _heights(-values if options.invert else values, unit, options.height)
    return HeightField.centred(z, _cell(z.shape, pixel, options))


def _gray(path: Path, pixels: NDArray[Any], grayscale: bool) -> NDArray[np.floating[Any]]:
    """Return (rows, cols) float32, or float64 where float32 would lose levels."""
    kind = np.float64 if pixels.dtype in (np.int32, np.uint32, np.float64) else np.float32
    gray: NDArray[np.floating[Any]]
    if pixels.ndim == 2:
        gray = pixels.astype(kind)
        return gray
    span = pixels.max(axis=2).astype(kind) - pixels.min(axis=2)
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "iu" else float(np.nanmax(np.abs(pixels)))
    if not grayscale and (span > GRAY_TOLERANCE * full / 255).any():
        raise SourceError(f"{path}: is in colour, a terrain needs a gray picture; --grayscale makes it gray")
    if not span.any():
        gray = pixels[..., 0].astype(kind)
        return gray
    gray = np.zeros(pixels.shape[:2], dtype=kind)
    for channel, weight in enumerate(LUMA):
        gray += pixels[..., channel] * float(weight)
    return gray


def _fill(path: Path, values: NDArray[np.floating[Any]], nodata: float | None) -> NDArray[np.floating[Any]]:
    """Give every pixel without a height that of the nearest pixel with one; warns how many."""
    missing = ~np.isfinite(values) | (values < -1e30)
    if nodata is not None:
        missing |= values == values.dtype.type(nodata)
    for value in UNTAGGED_NODATA:
        missing |= values == value
    count = int(missing.sum())
    if count == 0:
        return values
    share = f"{count} of {values.size} pixels have no height (NaN or nodata)"
    if count > values.size / 2:
        raise SourceError(f"{path}: {share}, at most half may lack one")
    warnings.warn(f"{path}: {share}, filled from their nearest neighbours", stacklevel=3)
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    filled: NDArray[np.floating[Any]] = values[tuple(nearest)]
    return filled


def _heights(
    values: NDArray[np.floating[Any]], unit: float | None, height: float | None
) -> NDArray[np.float32]:
    """Return (rows, cols) metres above the lowest point; a flat picture stays flat."""
    above = values - values.min()
    relief = float(above.max())
    if relief > 0 and (unit is None or height is not None):
        # The division first: the top comes out as exactly `height`.
        above = above / relief * (height or DEFAULT_HEIGHT)
    elif unit is not None and unit != 1.0:
        above = above * unit
    z: NDArray[np.float32] = above.astype(np.float32)
    return z


def _cell(
    shape: tuple[int, ...], pixel: tuple[float, float] | None, options: BuildOptions
) -> tuple[float, float]:
    """Return the spacing of the nodes eastward and northward, metres."""
    rows, cols = shape
    if options.pixel_size is not None:
        return options.pixel_size, options.pixel_size
    if isinstance(options.size, tuple):
        return options.size[0] / (cols - 1), options.size[1] / (rows - 1)
    if pixel is not None and options.size is None:
        return pixel
    sx, sy = pixel or (1.0, 1.0)
    factor = (options.size or DEFAULT_SIZE) / max((cols - 1) * sx, (rows - 1) * sy)
    return sx * factor, sy * factor
