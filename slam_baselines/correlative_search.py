"""Correlative search: the best pose in a window by brute force (Olson 2009)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray, njit
from slam_baselines.occupancy_map import FULL, GrowingGrid

ANGULAR_STEP = 0.02
"""Step of the correlative search, radians."""
SEARCH_BEAMS = 120
"""Largest number of beams that the correlative search uses, evenly chosen."""
DISTANCE_LOSS = 0.05
"""Loss of score per meter and per radian from the start of the correlative search."""


class _Cells(NamedTuple):
    """Map level: values, lattice row and column of cell (0, 0), cell size in meters."""

    value: ByteArray
    row0: int
    col0: int
    resolution: float


def correlative_search(
    grid: GrowingGrid,
    points: FloatArray,
    weights: FloatArray,
    start: FloatArray,
    linear: float,
    angular: float,
) -> FloatArray:
    """Return the best pose (3,) in a window around `start` (3,), by brute force.

    Olson 2009, "Real-time correlative scan matching": rotate the scan once for each yaw, then shift it by
    whole cells. Used where Gauss-Newton does not converge to the right pose, as after a sharp turn. Points
    (n, 2 or more) are ends of beams in the leveled base frame; `linear` and `angular` are the largest shift
    in x and in y, meters, and the largest turn, radians.
    """
    stride = max(1, -(-len(points) // SEARCH_BEAMS))
    cells = _Cells(grid.layers["value"], grid.row0, grid.col0, grid.resolution)
    reach, turns = int(linear / grid.resolution), int(angular / ANGULAR_STEP)
    best = np.empty(3)
    _search(cells, points[::stride], weights[::stride], start, reach, turns, best)
    return best


@njit
def _search(cells: _Cells, points: Any, weights: Any, start: Any, reach: int, turns: int, best: Any) -> None:
    """Fill `best` (3,) with the pose of the highest mean value minus distance loss."""
    rows, cols = cells.value.shape
    res, n = cells.resolution, len(points)
    at_row, at_col = np.empty(n, np.int64), np.empty(n, np.int64)
    total, best_score = 0.0, -np.inf
    for w in weights:
        total += w
    total = max(total, 1e-9) * FULL
    for k in range(-turns, turns + 1):
        yaw = start[2] + k * ANGULAR_STEP
        c, s = np.cos(yaw), np.sin(yaw)
        for i in range(n):
            at_col[i] = int(np.floor((start[0] + c * points[i, 0] - s * points[i, 1]) / res)) - cells.col0
            at_row[i] = int(np.floor((start[1] + s * points[i, 0] + c * points[i, 1]) / res)) - cells.row0
        for dr in range(-reach, reach + 1):
            for dc in range(-reach, reach + 1):
                score = 0.0
                for i in range(n):
                    r, q = at_row[i] + dr, at_col[i] + dc
                    if 0 <= r < rows and 0 <= q < cols:
                        score += weights[i] * cells.value[r, q]
                loss = DISTANCE_LOSS * np.hypot(dr, dc) * res + DISTANCE_LOSS * abs(k * ANGULAR_STEP)
                score = score / total - loss
                if score > best_score:
                    best_score = score
                    best[0], best[1], best[2] = start[0] + dc * res, start[1] + dr * res, yaw
