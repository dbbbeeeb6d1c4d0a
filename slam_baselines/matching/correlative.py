"""Correlative search: the best pose in a window by brute force on one map level.

Olson 2009, "Real-time correlative scan matching": rotate the scan once for each yaw, then shift it by
whole cells. Used where Gauss-Newton does not converge to the right pose (a sharp turn between two scans).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.checks import Checked, limited
from lirs_wct.kernels import njit
from slam_baselines.mapping.occupancy_map import FULL, GrowingGrid


@dataclass(frozen=True, kw_only=True)
class SearchConfig(Checked, of="the correlative search"):
    """Window of the search, and the weights of its candidates.

    Attributes:
        linear_search_window: largest shift in x and in y, meters.
        angular_search_window: largest turn, radians.
        angular_step: radians.
        beams: most beams that are used, evenly chosen.
        translation_weight: loss of score per meter from the start.
        rotation_weight: loss of score per radian from the start.
    """

    linear_search_window: float = limited(0.7, "(0, inf]")
    angular_search_window: float = limited(0.5, "(0, inf]")
    angular_step: float = limited(0.02, "(0, inf]")
    beams: int = limited(120, "(0, inf]")
    translation_weight: float = 0.05
    rotation_weight: float = 0.05


class _Cells(NamedTuple):
    """Map level: values, lattice row and column of cell (0, 0), cell size in meters."""

    value: ByteArray
    row0: int
    col0: int
    resolution: float


class _Window(NamedTuple):
    """Window: largest shift in cells, largest turn in steps, step in radians, losses."""

    reach: int
    turns: int
    step: float
    per_meter: float
    per_radian: float


def correlative_search(
    grid: GrowingGrid, points: FloatArray, weights: FloatArray, start: FloatArray, config: SearchConfig
) -> FloatArray:
    """Return the pose (3,) x, y, yaw of the best score in a window around `start`.

    Args:
        grid: level of the map, with the layer `value`.
        points: (n, 2 or more) ends of beams in the leveled base frame, meters.
        weights: (n,) of the beams.
        start: (3,) x, y, yaw.
        config: the window.
    """
    stride = max(1, -(-len(points) // config.beams))
    window = _Window(
        int(config.linear_search_window / grid.resolution),
        int(config.angular_search_window / config.angular_step),
        config.angular_step,
        config.translation_weight,
        config.rotation_weight,
    )
    cells = _Cells(grid.layers["value"], grid.row0, grid.col0, grid.resolution)
    best = np.empty(3)
    _search(cells, points[::stride], weights[::stride], start, window, best)
    return best


@njit
def _search(cells: _Cells, points: Any, weights: Any, start: Any, window: _Window, best: Any) -> None:
    """Fill `best` (3,) with the pose of the highest mean value minus the loss by distance."""
    rows, cols = cells.value.shape
    res, reach, turns = cells.resolution, window.reach, window.turns
    n = len(points)
    at_row, at_col = np.empty(n, np.int64), np.empty(n, np.int64)
    total, best_score = 0.0, -np.inf
    for w in weights:
        total += w
    total = max(total, 1e-9) * FULL
    for k in range(-turns, turns + 1):
        yaw = start[2] + k * window.step
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
                loss = window.per_meter * np.hypot(dr, dc) * res + window.per_radian * abs(k * window.step)
                score = score / total - loss
                if score > best_score:
                    best_score = score
                    best[0], best[1], best[2] = start[0] + dc * res, start[1] + dr * res, yaw
