"""Resampling of a grid."""

from __future__ import annotations

import cv2
import numpy as np

from lirs_wct.arrays import Float32Array
from lirs_wct.geometry.heightfield import HeightField

STRIP = 512
"""Rows of nodes that are sampled together; all at once would take several times the memory."""


def resample(values: Float32Array, width: int, height: int) -> Float32Array:
    """Resample values on another grid over the same ground; corner nodes stay corner nodes.

    Before shrinking, a Gaussian blur removes detail finer than the new grid (no aliasing).
    """
    rows, cols = values.shape
    shrink_x, shrink_y = (cols - 1) / (width - 1), (rows - 1) / (height - 1)
    if max(shrink_x, shrink_y) > 1:
        sigma_x, sigma_y = (max(0.5 * (s - 1), 1e-3) for s in (shrink_x, shrink_y))
        values = np.asarray(
            cv2.GaussianBlur(values, (0, 0), sigma_x, sigmaY=sigma_y, borderType=cv2.BORDER_REPLICATE),
            dtype=np.float32,
        )
    # One axis after the other: the maps stay small whatever the size.
    return _sample_columns(_sample_columns(values, width).T, height).T.copy()


def fewer_nodes(surface: HeightField, most: int) -> HeightField:
    """Return a surface on the same ground with at most `most` nodes along each side."""
    rows, cols = (min(n, most) for n in surface.shape)
    width, depth = surface.size
    z = resample(surface.z, cols, rows)
    return HeightField(z, (width / (cols - 1), depth / (rows - 1)), surface.origin)


def sample_surface(
    surface: HeightField, bounds: tuple[float, float, float, float], shape: tuple[int, int]
) -> HeightField:
    """Return a surface within bounds on nodes of its own, exact at each node."""
    (west, south, east, north), (rows, cols) = bounds, shape
    x, y = np.linspace(west, east, cols), np.linspace(north, south, rows)
    x, y = np.clip(x, west, east), np.clip(y, south, north)
    z = np.empty(shape, np.float32)
    for start in range(0, rows, STRIP):
        part = slice(start, start + STRIP)
        z[part] = surface.height_at(x[None, :], y[part, None])
    return HeightField(z, ((east - west) / (cols - 1), (north - south) / (rows - 1)), (west, south))


def _sample_columns(values: Float32Array, n: int) -> Float32Array:
    """Return (rows, n) values, interpolated linearly at n equidistant columns."""
    at = np.linspace(0, values.shape[1] - 1, n)
    left = np.minimum(at.astype(np.int64), values.shape[1] - 2)
    share = (at - left).astype(np.float32)
    out: Float32Array = values[:, left] * (1 - share) + values[:, left + 1] * share
    return out
