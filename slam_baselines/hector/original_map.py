"""One level of the original HectorSLAM's map: log-odds by Bresenham's lines, bilinear matching on them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.kernels import njit
from slam_baselines.common.linalg import solve3
from slam_baselines.mapping.bresenham import line_cells

MOST = 50.0
"""Log-odds from which on a cell is raised no more."""
LARGEST_TURN = 0.2
"""Radians that one Gauss-Newton step may turn."""


class OriginalMap:
    """A square map of log-odds, 0 where no beam came; a scan changes each cell once.

    As in the original, the size is fixed, the start is the center of cell (size / 2, size / 2), and a beam is
    drawn only where both its ends are inside.
    """

    def __init__(self, resolution: float, size: int, miss: float, hit: float) -> None:
        """Start empty.

        Args:
            resolution: edge of a cell, meters.
            size: cells along an edge of the map, even.
            miss: log-odds that a beam adds where it passes.
            hit: log-odds that a beam adds where it ends.
        """
        self._resolution, self._middle = resolution, size // 2
        self._odds = miss, hit
        self._log_odds = np.zeros((size, size), np.float32)
        self._probability = np.full((size, size), 0.5, np.float32)
        self._drawn = np.zeros((size, size), np.int32)
        self._scans = 0

    @property
    def nbytes(self) -> int:
        """Memory of its layers."""
        return self._log_odds.nbytes + self._probability.nbytes + self._drawn.nbytes

    def match(self, ends: FloatArray, pose: FloatArray, steps: int) -> FloatArray:
        """Return the (3,) pose after Gauss-Newton steps (Eqs. 7-13); `pose` where no end is inside.

        Args:
            ends: (n, 2) ends of beams in the base frame, meters.
            pose: (3,) x, y, yaw to start from.
            steps: of Gauss-Newton.
        """
        matched: FloatArray = _match(self._probability, self._middle, self._resolution, ends, pose, steps)
        return matched

    def draw(self, pose: Pose2, laser: FloatArray, ends: FloatArray) -> None:
        """Raise the cells where beams end, lower those that they pass.

        Args:
            pose: `T_map_base`.
            laser: (2,) in the base frame, meters.
            ends: (n, 2) of beams in the base frame, meters.
        """
        self._scans += 2
        points = np.vstack((pose.apply(laser[None]), pose.apply(ends)))
        size = len(self._drawn)
        # Clipped, so that no number is too large for a cell's; -1 and `size` are outside.
        cells = np.clip(points / self._resolution + self._middle + 0.5, -1, size).astype(np.int64)
        inside: BoolArray = np.all((cells >= 0) & (cells < size), axis=1)
        if inside[0]:
            layers = self._log_odds, self._probability, self._drawn
            _draw(layers, cells[inside], self._scans, self._odds)

    def occupancy_grid(self) -> OccupancyGrid:
        """Return what is known."""
        known, resolution = self._drawn > 0, self._resolution
        if not known.any():
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), resolution)
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        box = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        values = np.where(known[box], self._log_odds[box], np.float32(np.nan)).astype(np.float32)
        west, south = cols[0] - self._middle - 0.5, rows[0] - self._middle - 0.5
        return OccupancyGrid(values, resolution, Pose2(west * resolution, south * resolution))


@njit(cache=True, nogil=True)
def _match(probability: Any, middle: int, resolution: float, ends: Any, pose: Any, steps: int) -> Any:
    """Gauss-Newton in cells: the probability at the ends of the beams shall become 1 (Eq. 7)."""
    scale = 1 / resolution
    x, y, yaw = pose[0] * scale + middle, pose[1] * scale + middle, pose[2]
    for _ in range(steps):
        s, c = math.sin(yaw), math.cos(yaw)
        H, g = np.zeros((3, 3)), np.zeros(3)
        for k in range(len(ends)):
            u, v = ends[k, 0] * scale, ends[k, 1] * scale
            value, dx, dy = _interpolated(probability, c * u - s * v + x, s * u + c * v + y)
            turn = (-s * u - c * v) * dx + (c * u - s * v) * dy
            J = (dx, dy, turn)
            for i in range(3):
                g[i] += J[i] * (1 - value)
                for j in range(3):
                    H[i, j] += J[i] * J[j]
        if H[0, 0] == 0 or H[1, 1] == 0:
            break
        step = solve3(H, g)
        if not np.isfinite(step).all():
            break
        x, y = x + step[0], y + step[1]
        yaw += min(max(step[2], -LARGEST_TURN), LARGEST_TURN)
    return np.array(((x - middle) / scale, (y - middle) / scale, yaw))


@njit(cache=True, nogil=True)
def _interpolated(probability: Any, x: float, y: float) -> Any:
    """Return probability and its derivatives at a point in cells (Eqs. 4-6); zeros outside.

    The derivatives' weights are those of the original's code: both by the place along x and y of the
    difference itself, where the paper has the other axis.
    """
    rows, cols = probability.shape
    if not (0 <= x <= cols - 2 and 0 <= y <= rows - 2):
        return 0.0, 0.0, 0.0
    col, row = int(x), int(y)
    fx, fy = x - col, y - row
    a, b = probability[row, col], probability[row, col + 1]
    c, d = probability[row + 1, col], probability[row + 1, col + 1]
    value = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    return value, (b - a) * (1 - fx) + (d - c) * fx, (c - a) * (1 - fy) + (d - b) * fy


@njit(cache=True, nogil=True)
def _draw(layers: Any, cells: Any, scan: int, odds: Any) -> None:
    """Draw the lines from cells[0] to all others; `scan` marks a cell as passed, `scan` + 1 as hit."""
    log_odds, probability, drawn = layers
    for k in range(1, len(cells)):
        if cells[k, 0] == cells[0, 0] and cells[k, 1] == cells[0, 1]:
            continue
        for row, col in line_cells(cells[0, 1], cells[0, 0], cells[k, 1], cells[k, 0]):
            if drawn[row, col] < scan:
                _change(log_odds, probability, row, col, odds[0])
                drawn[row, col] = scan
        row, col = cells[k, 1], cells[k, 0]
        if drawn[row, col] < scan + 1:
            if drawn[row, col] == scan:  # passed by another beam of this scan: a hit wins
                _change(log_odds, probability, row, col, -odds[0])
            if log_odds[row, col] < MOST:
                _change(log_odds, probability, row, col, odds[1])
            drawn[row, col] = scan + 1


@njit(cache=True, inline="always")
def _change(log_odds: Any, probability: Any, row: int, col: int, by: float) -> None:
    log_odds[row, col] += by
    probability[row, col] = 1 - 1 / (1 + math.exp(log_odds[row, col]))
