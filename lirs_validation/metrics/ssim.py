"""Structural similarity of two maps seen as pictures."""

from __future__ import annotations

import cv2
import numpy as np

from lirs_validation.metrics.agreement import BAND, sampled
from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.geometry.grid import OccupancyGrid

WINDOW, SIGMA = 11, 1.5
"""Side and standard deviation of the Gaussian window, cells (Wang et al., Sec. III-C)."""
K1, K2 = 0.01, 0.03
"""Constants that keep the quotients finite, as in the paper, for pictures in [0, 1]."""


def map_ssim(built: OccupancyGrid, reference: OccupancyGrid) -> float | None:
    """Return the mean structural similarity over the cells known in both maps; None where there is none.

    The built map is read at the centers of the reference's cells. Pictures hold 0 for occupied, 1 for
    free and 0.5 for what is unknown or undecided.
    """
    moved = OccupancyGrid(sampled(built, reference), reference.resolution)
    both = moved.known & reference.known
    if not both.any():
        return None
    return float(similarity(as_picture(moved), as_picture(reference))[both].mean())


def as_picture(grid: OccupancyGrid) -> Float32Array:
    """Return (rows, cols) 0 for occupied, 1 for free, 0.5 for all else; row 0 = south."""
    picture = np.full(grid.shape, 0.5, np.float32)
    picture[grid.free] = 1.0
    picture[grid.occupied] = 0.0
    return picture


def similarity(x: FloatArray | Float32Array, y: FloatArray | Float32Array) -> FloatArray:
    """Return the structural similarity about each pixel of two pictures (rows, cols) in [0, 1].

    Wang et al., "Image Quality Assessment: From Error Visibility to Structural Similarity" (IEEE TIP
    2004), Eq. 13 with the moments of Eqs. 14-16; pictures are mirrored at their borders.
    """
    half = WINDOW // 2
    mirrored = np.pad(np.arange(len(x)), half, mode="symmetric")
    found = np.empty(x.shape)
    for first in range(0, len(found), BAND):
        rows = mirrored[first : first + BAND + 2 * half]
        parts = (np.asarray(picture[rows], dtype=np.float64) for picture in (x, y))
        found[first : first + BAND] = _similarity(*parts)[half:-half]
    return found


def _similarity(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return `similarity` away from the first and last rows: what is made on the way is large."""
    c1, c2 = K1**2, K2**2
    mx, my = _mean(x), _mean(y)
    vx, vy, cov = _mean(x * x) - mx * mx, _mean(y * y) - my * my, _mean(x * y) - mx * my
    above: FloatArray = (2 * mx * my + c1) * (2 * cov + c2)
    return above / ((mx * mx + my * my + c1) * (vx + vy + c2))


def _mean(picture: FloatArray) -> FloatArray:
    """Return the mean under the Gaussian window about each pixel."""
    blurred = cv2.GaussianBlur(picture, (WINDOW, WINDOW), SIGMA, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, dtype=np.float64)
