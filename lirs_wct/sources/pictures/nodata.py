"""Pixels without a height: filled, or told where the file does not say what they are."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lirs_wct.errors import SourceError

UNTAGGED_NODATA = (-9999.0, -32768.0)
"""What elevation rasters hold where nothing was measured, even without a tag; beyond 1e30 likewise."""
BORDER, CLIFF, STEPS = 0.02, 50.0, 10.0
"""Lowest value on the border as undeclared "no data": share of the border, meters of the cliff beside it, and
that over the usual step between neighbors."""


def fill_nodata(
    path: Path, values: NDArray[np.floating[Any]], nodata: float | None
) -> NDArray[np.floating[Any]]:
    """Give every pixel without a height that of the nearest pixel with one; warns how many.

    Raises:
        SourceError: more than half of the pixels have none.
    """
    missing = ~np.isfinite(values) | (np.abs(values) > 1e30)
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
    warnings.warn(f"{path}: {share}, filled from their nearest neighbors", stacklevel=3)
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    filled: NDArray[np.floating[Any]] = values[tuple(nearest)]
    return filled


def tell_border(path: Path, values: NDArray[np.floating[Any]], unit: float) -> None:
    """Warn of a border of the lowest value that stands beside a cliff: likely "no data" that nobody declared.

    Args:
        path: of the raster.
        values: (rows, cols), holes filled.
        unit: meters in a unit of height.
    """
    lowest = values.min()
    border = np.concatenate((values[0], values[-1], values[1:-1, 0], values[1:-1, -1]))
    if np.count_nonzero(border == lowest) < max(4, BORDER * border.size):
        return
    low = values == lowest
    label, _ = ndimage.label(low)
    edge = np.concatenate((label[0], label[-1], label[:, 0], label[:, -1]))
    low = np.isin(label, np.unique(edge[edge > 0]))
    beside = ndimage.binary_dilation(low) & ~low
    if not beside.any():
        return
    cliff = float(np.median(values[beside] - lowest)) * unit
    within = ~low[:, 1:] & ~low[:, :-1]
    steps = np.abs(np.diff(values, axis=1))[within]
    usual = float(np.median(steps)) * unit if steps.size else 0.0
    if cliff > max(CLIFF, STEPS * usual):
        warnings.warn(
            f"{path}: {int(low.sum())} pixels of {lowest:g} along the border stand beside heights "
            f"{cliff:.0f} m above them; where {lowest:g} means no height, say --nodata {lowest:g}",
            stacklevel=4,
        )
