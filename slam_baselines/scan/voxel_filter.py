"""Voxel filter: fewer points of a scan, evenly spread in space."""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import FloatArray


def voxel_filter(points: FloatArray, size: float, max_points: int) -> FloatArray:
    """Return at most `max_points` of the points, the first one of each square of the given size."""
    cells = np.floor(points[:, :2] / size).astype(np.int64)
    _, first = np.unique(cells[:, 0] * (1 << 20) + cells[:, 1], return_index=True)
    first.sort()
    stride = max(1, -(-len(first) // max_points))
    return np.asarray(points[first[::stride]], dtype=np.float64)
