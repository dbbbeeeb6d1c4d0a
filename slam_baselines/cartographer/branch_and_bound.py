"""Branch and bound: the best pose of a scan in a window without exhaustive search.

Hess et al. 2016, "Real-time loop closure in 2D LIDAR SLAM", Algorithm 3. A node of the tree is a turn
and a square of 2^h x 2^h shifts; the map in which each cell holds the highest value of the 2^h x 2^h
cells from it on gives a score that none of the node's poses exceeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray, njit
from slam_baselines.occupancy_map import FULL, GrowingGrid


class BoundGrids(NamedTuple):
    """A map and its upper bounds.

    Attributes:
        levels: (depth + 1, rows, cols) uint8; level h holds at (r, c) the highest value of the map in rows r
            ... r + 2^h - 1 and columns c ... c + 2^h - 1 (eq. 12).
        row0: Lattice row of the arrays' row 0.
        col0: Lattice column of the arrays' column 0.
        resolution: Edge of a cell, meters.
    """

    levels: ByteArray
    row0: int
    col0: int
    resolution: float

    @staticmethod
    def of(grid: GrowingGrid, depth: int) -> BoundGrids:
        """Precompute the bounds of a grid's layer `value`, whose zeros do not matter."""
        return BoundGrids.of_values(grid.layers["value"], (grid.row0, grid.col0), grid.resolution, depth)

    @staticmethod
    def of_values(value: ByteArray, corner: tuple[int, int], resolution: float, depth: int) -> BoundGrids:
        """Precompute the bounds of (rows, cols) values; `corner` is cell (0, 0) in the lattice."""
        rows, cols = (np.flatnonzero(value.any(axis=axis)) for axis in (1, 0))
        if len(rows) == 0:
            return BoundGrids(np.zeros((depth + 1, 1, 1), np.uint8), *corner, resolution)
        pad = 2**depth - 1
        known = value[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        levels = np.zeros((depth + 1, known.shape[0] + pad, known.shape[1] + pad), np.uint8)
        levels[0, pad:, pad:] = known
        fill_bounds(levels)
        row0, col0 = corner[0] + int(rows[0]) - pad, corner[1] + int(cols[0]) - pad
        return BoundGrids(levels, row0, col0, resolution)

    @property
    def nbytes(self) -> int:
        """Memory of the levels."""
        return self.levels.nbytes


def fill_bounds(levels: ByteArray) -> None:
    """Fill levels (depth + 1, rows, cols), each by four squares of the one before."""
    for h in range(len(levels) - 1):
        level, above, step = levels[h], levels[h + 1], 1 << h
        wide = level.copy()
        np.maximum(wide[:, :-step], level[:, step:], out=wide[:, :-step])
        above[:] = wide
        np.maximum(above[:-step], wide[step:], out=above[:-step])


class SearchWindow(NamedTuple):
    """Largest shift in x and in y from the start, meters, and largest turn, radians."""

    linear: float
    angular: float


class Exclusion(NamedTuple):
    """Disc of positions that a search leaves out: center (2 or more,) and radius, meters."""

    center: FloatArray
    radius: float


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Best pose of a search.

    Attributes:
        pose: (3,) x, y, yaw; the start where no pose has the minimum score.
        score: Mean value at the ends of the beams, 0 to 1; -1 where no pose has the minimum score.
        nodes: Number of nodes of the tree that were evaluated.
        complete: Whether the search ended within the limit of nodes.
    """

    pose: FloatArray
    score: float
    nodes: int
    complete: bool


class _Tree(NamedTuple):
    """Shifts of -reach ... reach cells and turns of -turns ... turns steps (radians) around a start."""

    start: FloatArray
    reach: int
    turns: int
    step: float


def angular_step(points: FloatArray, resolution: float) -> float:
    """Return the turn that moves the farthest point by a cell (eq. 7), radians."""
    farthest = max(float(np.hypot(points[:, 0], points[:, 1]).max()), 2 * resolution)
    return math.acos(1 - resolution**2 / (2 * farthest**2))


def branch_and_bound(
    grids: BoundGrids, points: FloatArray, start: FloatArray, window: SearchWindow, min_score: float,
    max_nodes: int = 1 << 20, excluded: Exclusion | None = None,
) -> SearchResult:  # fmt: skip
    """Find the pose of the best score in a window around `start` (3,).

    Points (n, 2 or more), n > 0, are ends of beams in the leveled base frame, meters. Poses of a lower score
    than `min_score`, and excluded positions, are not returned; the search ends after `max_nodes` of the tree.
    """
    resolution, step = grids.resolution, angular_step(points, grids.resolution)
    reach, turns = math.ceil(window.linear / resolution), math.ceil(window.angular / step)
    disc = np.full(3, -1.0)
    if excluded is not None:
        disc[:2] = (excluded.center[:2] - start[:2])[::-1] / resolution
        disc[2] = excluded.radius / resolution
    tree = _Tree(start, reach, turns, step)
    rows, cols = np.empty((2, 2 * turns + 1, len(points)), np.int32)
    roots = _roots(grids, points, tree, rows, cols)
    # Of equal scores the smaller index wins: the sort must be stable for the same answer everywhere.
    order = np.argsort(-roots[:, 0], kind="stable")
    out = np.empty(6)
    _search(grids, tree, min_score, max_nodes, disc, roots, order, rows, cols, out)
    return SearchResult(out[:3].copy(), float(out[3]), int(out[4]), bool(out[5]))


@njit
def _rotated_cells(points: Any, start: Any, yaw: float, lattice: BoundGrids, rows: Any, cols: Any) -> None:
    """Fill the cells of the points at one yaw and no shift."""
    c, s = np.cos(yaw), np.sin(yaw)
    for i in range(len(points)):
        x, y = start[0] + c * points[i, 0] - s * points[i, 1], start[1] + s * points[i, 0] + c * points[i, 1]
        cols[i] = int(np.floor(x / lattice.resolution)) - lattice.col0
        rows[i] = int(np.floor(y / lattice.resolution)) - lattice.row0


@njit
def _sum(level: Any, rows: Any, cols: Any, dr: int, dc: int) -> int:
    """Add up a level at shifted cells."""
    height, width = level.shape
    total = 0
    for i in range(len(rows)):
        r, c = rows[i] + dr, cols[i] + dc
        if 0 <= r < height and 0 <= c < width:
            total += level[r, c]
    return total


@njit
def _put(row: Any, score: int, level: int, turn: int, dr: int, dc: int) -> None:
    row[0], row[1], row[2], row[3], row[4] = score, level, turn, dr, dc


@njit
def _copy(row: Any, to: Any) -> None:
    # Not `to[:] = row`: Numba would compile the message of shapes that differ.
    for i in range(5):
        to[i] = row[i]


@njit
def _roots(lattice: BoundGrids, points: Any, tree: _Tree, rows: Any, cols: Any) -> Any:
    """Fill the cells of every turn; return roots (k, 5): score, level, turn, row, column."""
    depth, count = len(lattice.levels) - 1, 2 * tree.turns + 1
    side = 1 << depth
    across = 2 * tree.reach // side + 1
    roots = np.empty((count * across * across, 5), np.int32)
    k = 0
    for t in range(count):
        yaw = tree.start[2] + (t - tree.turns) * tree.step
        _rotated_cells(points, tree.start, yaw, lattice, rows[t], cols[t])
        for i in range(across):
            for j in range(across):
                dr, dc = i * side - tree.reach, j * side - tree.reach
                _put(roots[k], _sum(lattice.levels[depth], rows[t], cols[t], dr, dc), depth, t, dr, dc)
                k += 1
    return roots


@njit
def _branch(levels: Any, rows: Any, cols: Any, node: Any, reach: int, children: Any) -> int:
    """Fill a node's (5,) up to four children by ascending score; return their number."""
    h, t, dr, dc = node[1], np.int64(node[2]), node[3], node[4]
    half, m = 1 << (h - 1), 0
    for q in range(4):
        r, c = dr + half * (q >> 1), dc + half * (q & 1)
        if r > reach or c > reach:
            continue
        score = _sum(levels[h - 1], rows[t], cols[t], r, c)
        p = m
        while p > 0 and children[p - 1, 0] > score:
            _copy(children[p - 1], children[p])
            p -= 1
        _put(children[p], score, h - 1, t, r, c)
        m += 1
    return m


@njit
def _search(
    lattice: BoundGrids, tree: _Tree, min_score: float, max_nodes: int, excluded: Any, roots: Any, order: Any,
    rows: Any, cols: Any, out: Any,
) -> None:  # fmt: skip
    """Depth-first search, the most promising branch first; fill `out` (6,).

    The exclusion (3,) is row, column and radius in cells.
    """
    levels, start, res = lattice.levels, tree.start, lattice.resolution
    n, depth = rows.shape[1], len(levels) - 1
    best = int(np.ceil(min_score * n * FULL)) - 1
    out[0], out[1], out[2], out[3] = start[0], start[1], start[2], -1.0
    evaluated = len(roots)
    stack, children = np.empty((4 * depth + 4, 5), np.int32), np.empty((4, 5), np.int32)
    for o in order:
        if roots[o, 0] <= best or evaluated > max_nodes:
            break
        _copy(roots[o], stack[0])
        top = 1
        while top > 0 and evaluated <= max_nodes:
            top -= 1
            node = stack[top]
            score, h, t, dr, dc = node[0], node[1], node[2], node[3], node[4]
            if score <= best:
                continue
            if h == 0:
                if (dr - excluded[0]) ** 2 + (dc - excluded[1]) ** 2 < excluded[2] * abs(excluded[2]):
                    continue
                best = score
                out[0], out[1] = start[0] + dc * res, start[1] + dr * res
                out[2] = start[2] + (t - tree.turns) * tree.step
                out[3] = score / (n * FULL)
                continue
            m = _branch(levels, rows, cols, node, tree.reach, children)
            evaluated += m
            for q in range(m):  # ascending: the best comes off the stack first
                if children[q, 0] > best:
                    _copy(children[q], stack[top])
                    top += 1
    out[4], out[5] = evaluated, evaluated <= max_nodes
