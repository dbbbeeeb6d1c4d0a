"""The best of all poses in a window, without trying all: branch and bound over a scan's place in a map.

Hess et al. 2016, "Real-time loop closure in 2D LIDAR SLAM", Algorithm 3. A node of the tree is a turn
and a square of 2^h x 2^h shifts; the map in which each cell holds the highest value of the 2^h x 2^h
cells from it on gives a score that none of the node's poses exceeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from lirs_wct.arrays import ByteArray, FloatArray
from slam_baselines.mapping.growing_grid import GrowingGrid
from slam_baselines.mapping.occupancy_map import FULL


@dataclass(frozen=True, slots=True)
class BoundGrids:
    """A map and its upper bounds.

    Attributes:
        levels: (depth + 1, rows, cols) uint8; level h holds at (r, c) the highest value of the map in rows
            r ... r + 2^h - 1 and columns c ... c + 2^h - 1 (eq. 12).
        row0: lattice row of the arrays' row 0.
        col0: lattice column of the arrays' column 0.
        resolution: edge of a cell, metres.
    """

    levels: ByteArray
    row0: int
    col0: int
    resolution: float

    @staticmethod
    def of(grid: GrowingGrid, depth: int) -> BoundGrids:
        """Precompute the bounds of a grid's layer `value`, of which only what is not 0 matters."""
        value = grid.layers["value"]
        rows, cols = (np.flatnonzero(value.any(axis=axis)) for axis in (1, 0))
        if len(rows) == 0:
            return BoundGrids(np.zeros((depth + 1, 1, 1), np.uint8), grid.row0, grid.col0, grid.resolution)
        pad = 2**depth - 1
        known = value[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        levels = np.zeros((depth + 1, known.shape[0] + pad, known.shape[1] + pad), np.uint8)
        levels[0, pad:, pad:] = known
        for h in range(depth):
            _pool(levels[h], 2**h, levels[h + 1])
        return BoundGrids(
            levels, grid.row0 + int(rows[0]) - pad, grid.col0 + int(cols[0]) - pad, grid.resolution
        )

    @property
    def nbytes(self) -> int:
        """Memory of the levels."""
        return self.levels.nbytes


def _pool(level: ByteArray, step: int, out: ByteArray) -> None:
    """Join four squares of `step` cells to one of twice the edge."""
    wide = level.copy()
    np.maximum(wide[:, :-step], level[:, step:], out=wide[:, :-step])
    out[:] = wide
    np.maximum(out[:-step], wide[step:], out=out[:-step])


@dataclass(frozen=True, slots=True)
class Found:
    """What a search has found.

    Attributes:
        pose: (3,) x, y, yaw of the best pose; the start where none has the least score.
        score: mean value at the ends of the beams, 0 to 1; below the least score where there is none.
        bounded: nodes of the tree that were looked at.
        complete: whether the search came to its end within the limit of nodes.
    """

    pose: FloatArray
    score: float
    bounded: int
    complete: bool


def angular_step(points: FloatArray, resolution: float) -> float:
    """Return the turn that moves the farthest point by a cell (eq. 7), radians."""
    farthest = max(float(np.hypot(points[:, 0], points[:, 1]).max()), 2 * resolution)
    return math.acos(1 - resolution**2 / (2 * farthest**2))


def branch_and_bound(
    grids: BoundGrids, points: FloatArray, start: FloatArray, linear: float, angular: float,
    min_score: float, limit: int = 1 << 20, apart_from: FloatArray | None = None, apart: float = 0.0,
) -> Found:  # fmt: skip
    """Find the pose of the best score around `start`.

    Args:
        grids: the map and its bounds.
        points: (n, 2 or more) ends of beams in the leveled base frame, metres; n > 0.
        start: (3,) x, y, yaw in the middle of the window.
        linear: shifts up to this in x and in y, metres.
        angular: turns up to this, radians.
        min_score: poses of a lower score are not looked for.
        limit: the search is given up after so many nodes of the tree.
        apart_from: (2 or more,) x, y of a place whose neighbourhood is left out ...
        apart: ... up to this distance, metres.
    """
    step = angular_step(points, grids.resolution)
    turns = math.ceil(angular / step)
    reach = math.ceil(linear / grids.resolution)
    out = np.empty(6)
    left_out = np.full(3, -1.0)
    if apart_from is not None:
        left_out[:2] = (apart_from[:2] - start[:2])[::-1] / grids.resolution
        left_out[2] = apart / grids.resolution
    _search(
        grids.levels, grids.row0, grids.col0, grids.resolution, points, start, reach, turns, step,
        min_score, limit, left_out, out,
    )  # fmt: skip
    return Found(out[:3].copy(), float(out[3]), int(out[4]), bool(out[5]))


@njit(cache=True)
def _turned(points, start, yaw, res, row0, col0, rows, cols):  # type: ignore[no-untyped-def]
    """Fill the cells of the points at one turn and no shift."""
    c, s = np.cos(yaw), np.sin(yaw)
    for i in range(len(points)):
        cols[i] = int(np.floor((start[0] + c * points[i, 0] - s * points[i, 1]) / res)) - col0
        rows[i] = int(np.floor((start[1] + s * points[i, 0] + c * points[i, 1]) / res)) - row0


@njit(cache=True)
def _sum(level, rows, cols, dr, dc):  # type: ignore[no-untyped-def]
    """Add up a level at shifted cells."""
    height, width = level.shape
    total = 0
    for i in range(len(rows)):
        r, c = rows[i] + dr, cols[i] + dc
        if 0 <= r < height and 0 <= c < width:
            total += level[r, c]
    return total


@njit(cache=True)
def _put(row, score, level, turn, dr, dc):  # type: ignore[no-untyped-def]
    row[0], row[1], row[2], row[3], row[4] = score, level, turn, dr, dc


@njit(cache=True)
def _search(levels, row0, col0, res, points, start, reach, turns, step, min_score, limit, left_out, out):  # type: ignore[no-untyped-def]
    """Depth-first search, the most promising branch first; fill `out` (6,)."""
    n, depth = len(points), len(levels) - 1
    count = 2 * turns + 1
    rows, cols = np.empty((count, n), np.int32), np.empty((count, n), np.int32)
    side = 1 << depth
    across = 2 * reach // side + 1
    roots = np.empty((count * across * across, 5), np.int32)  # score, level, turn, row, col
    k = 0
    for t in range(count):
        _turned(points, start, start[2] + (t - turns) * step, res, row0, col0, rows[t], cols[t])
        for i in range(across):
            for j in range(across):
                dr, dc = i * side - reach, j * side - reach
                _put(roots[k], _sum(levels[depth], rows[t], cols[t], dr, dc), depth, t, dr, dc)
                k += 1
    # Of equal scores the smaller index wins: the sort must be stable for the same answer everywhere.
    order = np.argsort(-roots[:, 0], kind="mergesort")
    best = int(np.ceil(min_score * n * FULL)) - 1
    out[0], out[1], out[2], out[3] = start[0], start[1], start[2], -1.0
    looked = k
    stack = np.empty((4 * depth + 4, 5), np.int32)
    children = np.empty((4, 5), np.int32)
    for o in order:
        if roots[o, 0] <= best or looked > limit:
            break
        stack[0] = roots[o]
        top = 1
        while top > 0 and looked <= limit:
            top -= 1
            score, h, t, dr, dc = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4]
            if score <= best:
                continue
            if h == 0:
                if (dr - left_out[0]) ** 2 + (dc - left_out[1]) ** 2 < left_out[2] * abs(left_out[2]):
                    continue
                best = score
                out[0], out[1], out[2] = (
                    start[0] + dc * res,
                    start[1] + dr * res,
                    start[2] + (t - turns) * step,
                )
                out[3] = score / (n * FULL)
                continue
            half, m = 1 << (h - 1), 0
            for q in range(4):
                r, c = dr + half * (q >> 1), dc + half * (q & 1)
                if r > reach or c > reach:
                    continue
                value = _sum(levels[h - 1], rows[t], cols[t], r, c)
                looked += 1
                p = m
                while p > 0 and children[p - 1, 0] > value:  # ascending: the best comes off the stack first
                    children[p] = children[p - 1]
                    p -= 1
                _put(children[p], value, h - 1, t, r, c)
                m += 1
            for q in range(m):
                if children[q, 0] > best:
                    stack[top] = children[q]
                    top += 1
    out[4], out[5] = looked, looked <= limit
