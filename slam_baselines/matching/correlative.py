"""Correlative search: the best of all poses in a window, by brute force over one level of the map.

Olson 2009, "Real-time correlative scan matching": rotate the scan once for each yaw, then shift it by
whole cells. Used where Gauss-Newton has not found its way (a sharp turn between two scans).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from slam_baselines.mapping.growing_grid import GrowingGrid
from slam_baselines.mapping.occupancy_map import FULL


@dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """The window of the search, and how it is weighed.

    Attributes:
        linear_search_window: shifts up to this in x and in y, metres.
        angular_search_window: turns up to this, radians.
        angular_step: radians.
        beams: at most so many beams are used, evenly chosen.
        translation_weight: loss of score per metre from the start.
        rotation_weight: loss of score per radian from the start.

    Raises:
        ConfigError: a window, step or number that is not above 0.
    """

    linear_search_window: float = 0.7
    angular_search_window: float = 0.5
    angular_step: float = 0.02
    beams: int = 120
    translation_weight: float = 0.05
    rotation_weight: float = 0.05

    def __post_init__(self) -> None:
        if min(self.linear_search_window, self.angular_search_window, self.angular_step, self.beams) <= 0:
            raise ConfigError("windows, angular_step and beams of a correlative search must be above 0")


def search(
    grid: GrowingGrid, points: FloatArray, weights: FloatArray, start: FloatArray, config: SearchConfig
) -> FloatArray:
    """Return the (3,) pose x, y, yaw in the window around `start` that has the best score.

    Args:
        grid: level of the map, with the layer `value`.
        points: (n, 2 or more) ends of beams in the leveled base frame, metres.
        weights: (n,) how much each counts.
        start: (3,) x, y, yaw.
        config: the window.
    """
    stride = max(1, -(-len(points) // config.beams))
    reach = int(config.linear_search_window / grid.resolution)
    turns = int(config.angular_search_window / config.angular_step)
    best = np.empty(3)
    _search(
        grid.layers["value"], grid.row0, grid.col0, grid.resolution, points[::stride], weights[::stride],
        start, reach, turns, config.angular_step, config.translation_weight, config.rotation_weight, best,
    )  # fmt: skip
    return best


@njit(cache=True)
def _search(  # type: ignore[no-untyped-def]
    value, row0, col0, res, points, weights, start, reach, turns, step, per_meter, per_radian, best
):
    """Fill `best` (3,) with the pose of the highest mean value, less the loss for its distance."""
    rows, cols = value.shape
    n = len(points)
    at_row, at_col = np.empty(n, np.int64), np.empty(n, np.int64)
    total = max(weights.sum(), 1e-9) * FULL
    best_score = -np.inf
    for k in range(-turns, turns + 1):
        yaw = start[2] + k * step
        c, s = np.cos(yaw), np.sin(yaw)
        for i in range(n):
            at_col[i] = int(np.floor((start[0] + c * points[i, 0] - s * points[i, 1]) / res)) - col0
            at_row[i] = int(np.floor((start[1] + s * points[i, 0] + c * points[i, 1]) / res)) - row0
        for dr in range(-reach, reach + 1):
            for dc in range(-reach, reach + 1):
                score = 0.0
                for i in range(n):
                    r, q = at_row[i] + dr, at_col[i] + dc
                    if 0 <= r < rows and 0 <= q < cols:
                        score += weights[i] * value[r, q]
                loss = per_meter * np.hypot(dr, dc) * res + per_radian * abs(k * step)
                score = score / total - loss
                if score > best_score:
                    best_score = score
                    best[0], best[1], best[2] = start[0] + dc * res, start[1] + dr * res, yaw
