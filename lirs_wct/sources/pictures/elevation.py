"""Elevation data of a raster: heights encoded in colors, units, georeference, missing heights."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # its modules load on first use
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.images.elevation import Raster, RasterInfo, decode, tile_georeference
from lirs_wct.formats.images.nodata import missing_heights
from lirs_wct.geometry.geodesy import Place
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.sources.options import BuildOptions

Rectangle = tuple[slice, slice]
"""Rows and columns of a raster."""
STEEPER = 0.01
"""Relative change of slopes above which a given extent without given heights causes a warning."""
BORDER, CLIFF, STEPS = 0.02, 50.0, 10.0
"""Limits for the lowest value on the border as undeclared "no data": share of the border, height of the cliff
next to it (meters), and ratio of the cliff to the usual step between neighbors."""


def decode_heights(path: Path, raster: Raster, options: BuildOptions) -> Raster:
    """Return the raster with colors decoded to heights.

    Raises:
        SourceError: the raster has no colors.
        ConfigError: the extent of the raster is unknown.
    """
    if options.encoding == "gray":
        return raster
    if raster.pixels.ndim != 3 or raster.pixels.dtype != np.uint8:
        raise SourceError(f"{path}: {options.encoding} is 8-bit color, this is {raster.pixels.dtype} gray")
    shape = raster.pixels.shape[:2]
    georeference = raster.info.georeference or tile_georeference(path, (shape[0], shape[1]))
    if georeference is None and options.size is None and options.resolution is None:
        raise ConfigError(
            f"{path}: its heights are in meters, its extent is not known: give --resolution or --size"
        )
    return Raster(decode(raster.pixels, options.encoding), RasterInfo(georeference, unit=1.0))


def pixel_of(info: RasterInfo) -> tuple[float, float] | None:
    """Return the size of a pixel on the ground, eastward and northward, meters; None if unknown."""
    return None if info.georeference is None else info.georeference.pixel


def place_of(
    raster: Raster, surface: HeightField, height: float | None, options: BuildOptions
) -> Place | None:
    """Return the georeference of the terrain, if the raster has one."""
    found = raster.info.georeference
    if found is None:
        return None
    left, top, cols, rows = options.crop or (0, 0, *raster.pixels.shape[1::-1])
    (west, south), (width, depth) = surface.origin, surface.size
    across, down = (cols - 1) / width, (rows - 1) / depth
    a, b, _, d, e, _ = found.affine
    # The column at x = 0, and the row at y = 0, of the whole raster.
    x0, y0 = found.coordinates(left - west * across, top + (south + depth) * down)
    return Place(found.system, (a * across, -b * down, x0, d * across, -e * down, y0), height)


def warn_slope_change(path: Path, raster: Raster, surface: HeightField, options: BuildOptions) -> None:
    """Warn if the extent is given and the heights are not, because slopes change."""
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


def fill_nodata(
    path: Path, values: NDArray[np.floating[Any]], nodata: float | None, kept: Rectangle, *, search: bool
) -> NDArray[np.floating[Any]]:
    """Fill every pixel without a height from its nearest neighbor; warn with their number.

    Args:
        path: path of the raster.
        values: (rows, cols) pixels.
        nodata: declared value of pixels without a height.
        kept: rows and columns of the world, of which at most half may lack a height.
        search: whether isolated codes mean "no height".

    Raises:
        SourceError: more than half of the kept pixels have no height.
    """
    missing, codes = missing_heights(values, nodata, search=search)
    count = int(missing.sum())
    if count == 0:
        return values
    if missing[kept].mean() > 0.5:
        raise SourceError(
            f"{path}: {int(missing[kept].sum())} of {missing[kept].size} pixels have no height (NaN or "
            "nodata), at most half may lack one; --window X,Y,SIDE keeps a part"
        )
    share = f"{count} of {values.size} pixels have no height (NaN or nodata)"
    if codes:
        known = values[~missing]
        share += (
            f", {' and '.join(f'{code:g}' for code in codes)} among them: an isolated level, the others are "
            f"{known.min():.6g} to {known.max():.6g}"
        )
    warnings.warn(f"{path}: {share}, filled from their nearest neighbors", stacklevel=3)
    nearest = scipy.ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    filled: NDArray[np.floating[Any]] = values[tuple(nearest)]
    return filled


def warn_nodata_border(path: Path, values: NDArray[np.floating[Any]], unit: float) -> None:
    """Warn of a border of the lowest value next to a cliff, likely undeclared "no data".

    Args:
        path: path of the raster.
        values: (rows, cols) heights with filled holes.
        unit: meters per unit of height.
    """
    lowest = values.min()
    border = np.concatenate((values[0], values[-1], values[1:-1, 0], values[1:-1, -1]))
    if np.count_nonzero(border == lowest) < max(4, BORDER * border.size):
        return
    low = values == lowest
    label, _ = scipy.ndimage.label(low)
    edge = np.concatenate((label[0], label[-1], label[:, 0], label[:, -1]))
    low = np.isin(label, np.unique(edge[edge > 0]))
    beside = scipy.ndimage.binary_dilation(low) & ~low
    if not beside.any():
        return
    cliff = float(np.median(values[beside] - lowest)) * unit
    within = ~low[:, 1:] & ~low[:, :-1]
    steps = np.abs(np.diff(values, axis=1))[within]
    usual = float(np.median(steps)) * unit if steps.size else 0.0
    if cliff > max(CLIFF, STEPS * usual):
        warnings.warn(
            f"{path}: {int(low.sum())} pixels of {lowest:g} along the border stand beside heights "
            f"{cliff:.0f} m above them; where {lowest:g} means no height, say --option nodata={lowest:g}",
            stacklevel=4,
        )
