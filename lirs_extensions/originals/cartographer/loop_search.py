"""Loop search of the original: branch and bound in finished submaps, then refinement.

Hess et al. 2016, section V-B, as in the original's fast_correlative_scan_matcher_2d and
constraint_builder_2d.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_extensions.originals.cartographer.config import CartographerOriginalConfig
from lirs_extensions.originals.cartographer.probability_grid import COST, MAX_COST, MIN_COST, ProbabilityGrid
from lirs_extensions.originals.cartographer.scan_matching import match_scan, rotated_cells, shifted_pose
from lirs_wct.arrays import ByteArray, Float32Array, njit
from lirs_wct.geometry import Pose2

MAX_BOUND = 255
"""Bound that stands for the largest probability of a cell; 0 is the smallest, as of unknown cells."""


class FoundLoop(NamedTuple):
    """A scan matched in a submap.

    Attributes:
        pose: Pose of the points in the local frame.
        score: mean probability at the points before refinement.
    """

    pose: Pose2
    score: float


class LoopSearcher:
    """Searches one finished submap; its bounds are computed once."""

    def __init__(self, grid: ProbabilityGrid, config: CartographerOriginalConfig) -> None:
        self._grid, self._config = grid, config
        self._bounds = bound_grids(grid, config.branch_and_bound_depth)
        self._num_pulses = self._num_samples = 0

    @property
    def nbytes(self) -> int:
        """Memory of the bounds."""
        return self._bounds.nbytes

    def draw_sample(self) -> bool:
        """Return whether the next node is searched for: a fixed share of them."""
        self._num_pulses += 1
        if self._num_samples / self._num_pulses >= self._config.sampling_ratio:
            return False
        self._num_samples += 1
        return True

    def search(self, points: Float32Array, expected: Pose2) -> FoundLoop | None:
        """Return the best pose of points (n, 2) near an expected one, if good enough."""
        c, grid = self._config, self._grid
        cells, turns, reach = rotated_cells(
            grid, points, expected, c.linear_search_window, c.angular_search_window
        )
        size = np.array(grid.cells.shape)
        low = np.maximum(-reach, np.minimum(0, -cells.max(axis=1)))
        high = np.minimum(reach, np.maximum(0, size - 1 - cells.min(axis=1)))
        scale = float(MAX_COST - MIN_COST) / MAX_BOUND
        least = (c.min_score - float(1 - MAX_COST)) / scale * len(points)
        margin = (1 << (c.branch_and_bound_depth - 1)) - 1
        indices = np.ascontiguousarray(cells.transpose(0, 2, 1)) + margin
        total, k, row, col = _best_candidate(self._bounds, indices, low, high, math.floor(least))
        if total < 0:
            return None
        edge = grid.resolution
        found = shifted_pose(expected, row * edge, col * edge, float(turns[k]))
        score = float(1 - MAX_COST) + scale * total / len(points)
        return FoundLoop(match_scan(grid, points, found, found, c.loop_matcher), score)


def bound_grids(grid: ProbabilityGrid, depth: int) -> ByteArray:
    """Return (depth, rows + margin, cols + margin) upper bounds of the probability.

    Level i holds the largest of the 2^i x 2^i cells that begin at a cell. The margin of 2^(depth - 1) - 1
    cells lies before the first row and column.
    """
    margin = (1 << (depth - 1)) - 1
    probability = (MAX_COST - COST[grid.cells]) * (MAX_BOUND / (MAX_COST - MIN_COST))
    rows, cols = grid.cells.shape
    bounds = np.zeros((depth, rows + margin, cols + margin), np.uint8)
    bounds[0, margin:, margin:] = np.floor(probability + 0.5)
    for level in range(1, depth):
        half, below, at = 1 << (level - 1), bounds[level - 1], bounds[level]
        along = below.copy()
        np.maximum(along[:, :-half], below[:, half:], out=along[:, :-half])
        at[:] = along
        np.maximum(at[:-half], along[half:], out=at[:-half])
    return bounds


@njit
def _best_candidate(bounds: Any, cells: Any, low: Any, high: Any, least: int) -> tuple[int, int, int, int]:
    """Return the best sum above `least` on the finest level: sum, turn, rows, columns.

    The sum is -1 where none is above. The candidate with the largest bound is expanded first; the stack holds
    bound, level, turn, rows and columns of each.
    """
    top, count, sums = len(bounds) - 1, 0, np.empty(4, np.int64)
    stack = np.empty((_coarse_candidates(low, high, 1 << top) + 4 * len(bounds), 5), np.int64)
    for k in range(len(cells)):
        for col in range(low[k, 1], high[k, 1] + 1, 1 << top):
            for row in range(low[k, 0], high[k, 0] + 1, 1 << top):
                _sum_bounds(bounds[top], cells[k], row, col, 0, sums)
                if sums[0] > least:
                    _put(stack, count, count, sums[0], (top, k, row, col))
                    count += 1
    stack[:count] = stack[np.argsort(stack[:count, 0])]
    best = (-1, 0, 0, 0)
    while count > 0:
        count -= 1
        total, level, k, row, col = stack[count]
        if total <= least:
            continue
        if level == 0:
            best, least = (total, k, row, col), total
            continue
        half, first = 1 << (level - 1), count
        _sum_bounds(bounds[level - 1], cells[k], row, col, half, sums)
        for j in range(4):
            r, c = row + half * (j & 1), col + half * (j >> 1)
            if sums[j] > least and r <= high[k, 0] and c <= high[k, 1]:
                _put(stack, first, count, sums[j], (level - 1, k, r, c))
                count += 1
    return best


@njit
def _coarse_candidates(low: Any, high: Any, step: int) -> int:
    """Return the number of candidates on the coarsest level."""
    count = 0
    for k in range(len(low)):
        rows, cols = high[k, 0] - low[k, 0] + step, high[k, 1] - low[k, 1] + step
        count += (rows // step) * (cols // step)
    return count


@njit
def _put(stack: Any, first: int, count: int, total: int, candidate: Any) -> None:
    """Insert a candidate into the stack of `count`, ordered by bounds from `first` on."""
    at = count
    while at > first and stack[at - 1, 0] > total:
        for i in range(5):
            stack[at, i] = stack[at - 1, i]
        at -= 1
    stack[at, 0] = total
    for i in range(4):
        stack[at, i + 1] = candidate[i]


@njit
def _sum_bounds(bounds: Any, cells: Any, row: int, col: int, half: int, sums: Any) -> None:
    """Fill the sums (4,) of bounds at cells (2, n) after four shifts.

    They are (row, col), and the same with `half` more rows, more columns, and both.
    """
    # Unsigned: a negative index is beyond the last row or column, too.
    rows, cols, h = np.uintp(bounds.shape[0]), np.uintp(bounds.shape[1]), np.uintp(half)
    near = right = above = far = np.int64(0)
    for i in range(cells.shape[1]):
        r, c = np.uintp(cells[0, i] + row), np.uintp(cells[1, i] + col)
        p, q = r + h, c + h
        if r < rows and p < rows and c < cols and q < cols:
            near += bounds[r, c]
            above += bounds[p, c]
            right += bounds[r, q]
            far += bounds[p, q]
            continue
        if c < cols:
            near += bounds[r, c] if r < rows else 0
            above += bounds[p, c] if p < rows else 0
        if q < cols:
            right += bounds[r, q] if r < rows else 0
            far += bounds[p, q] if p < rows else 0
    sums[0], sums[1], sums[2], sums[3] = near, above, right, far
