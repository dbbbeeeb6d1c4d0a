"""A laser map as one closed solid: walls and floor on a slab.

The plan is cut into rectangles of wall and of floor. Every corner of any rectangle is made a vertex of
all rectangles that it touches, so that no edge ends in the middle of another. Where two walls touch
only at a corner, each has its own upper vertex there: an edge never joins more than two triangles.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_wct.mesh import TriangleMesh
from lirs_wct.occupancy import merged_boxes
from lirs_wct.walls import WallGrid

SLAB = 0.1
"""Thickness of the floor, metres."""
BOTTOM, FLOOR, TOP, TWIN_TOP, LEVELS = 0, 1, 2, 3, 4
"""Heights that a corner of the plan can have; the twin is the upper vertex of a second wall."""


def wall_mesh(walls: WallGrid, slab: float = SLAB) -> TriangleMesh:
    """Return walls, floor and slab as one watertight solid in the world frame.

    Args:
        walls: cells that stand from z = 0 to their height.
        slab: thickness of the floor below z = 0, metres.
    """
    floor = WallGrid(~walls.solid, walls.resolution, walls.origin, walls.height)
    boxes = [merged_boxes(walls), merged_boxes(floor)]
    rectangles = np.concatenate(boxes)
    is_wall = np.repeat((True, False), [len(b) for b in boxes])
    codes = _triangles(rectangles, is_wall, np.pad(walls.solid, 1), _corners(rectangles, walls.shape))
    used, faces = np.unique(codes, return_inverse=True)
    vertices = _placed(used, rectangles, is_wall, walls, slab)
    return TriangleMesh(vertices, faces.reshape(-1, 3).astype(np.int32))


def _corners(rectangles: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Mark the lattice points (rows + 1, cols + 1) that are a corner of some rectangle."""
    marked = np.zeros((shape[0] + 1, shape[1] + 1), np.bool_)
    for row, col in ((0, 1), (0, 3), (2, 1), (2, 3)):
        marked[rectangles[:, row], rectangles[:, col]] = True
    return marked


def _placed(
    used: NDArray[np.int64],
    rectangles: NDArray[np.int64],
    is_wall: NDArray[np.bool_],
    walls: WallGrid,
    slab: float,
) -> NDArray[np.float64]:
    """Return (n, 3) what codes stand for: lattice points at a level, then middles of rectangles."""
    rows, cols = walls.shape
    lattice = (rows + 1) * (cols + 1) * LEVELS
    heights = np.array((-slab, 0.0, walls.height, walls.height))
    corner, middle = used[used < lattice], used[used >= lattice] - lattice
    point, level = np.divmod(corner, LEVELS)
    row, col = np.divmod(point, cols + 1)
    # The last middle is that of the slab's underside.
    boxes = np.concatenate((rectangles, np.array([[0, 0, rows, cols]])))[middle]
    tops = np.append(np.where(is_wall, walls.height, 0.0), -slab)[middle]
    plan = np.concatenate((np.stack((col, row), axis=-1), (boxes[:, [1, 0]] + boxes[:, [3, 2]]) / 2))
    xy = walls.origin.apply(plan * walls.resolution)
    return np.column_stack((xy, np.concatenate((heights[level], tops))))


@njit(cache=True)
def _triangles(rectangles, is_wall, padded, marked):  # type: ignore[no-untyped-def]
    """Return (m, 3) vertex codes; `padded` is the wall mask with a rim of floor around it."""
    rows, cols = marked.shape[0] - 1, marked.shape[1] - 1
    lattice = (rows + 1) * (cols + 1) * LEVELS
    room = 0
    for r0, c0, r1, c1 in rectangles:
        room += 5 * (marked[r0, c0:c1].sum() + marked[r1, c0:c1].sum())
        room += 5 * (marked[r0:r1, c0].sum() + marked[r0:r1, c1].sum()) + 10
    faces = np.empty((room + 2 * (rows + cols) + 8, 3), np.int64)
    n = 0
    for k in range(len(rectangles)):
        r0, c0, r1, c1 = rectangles[k]
        ring = _ring(r0, c0, r1, c1, marked)
        wall = is_wall[k]
        for i in range(len(ring)):
            p, q = ring[i], ring[(i + 1) % len(ring)]
            p0, q0 = _code(p, FLOOR, cols), _code(q, FLOOR, cols)
            # The cell on the inner (left) side of p -> q, and its neighbour on the outer side.
            inner_row = p[0] - (1 if q[1] < p[1] else 0) - (1 if q[0] < p[0] else 0)
            inner_col = p[1] - (1 if q[1] < p[1] else 0) - (1 if q[0] > p[0] else 0)
            outer_row = inner_row + (-1 if q[1] > p[1] else 1 if q[1] < p[1] else 0)
            outer_col = inner_col + (1 if q[0] > p[0] else -1 if q[0] < p[0] else 0)
            ph, qh = p0, q0
            if wall:
                ph = _code(p, _top(p, inner_row, padded), cols)
                inner_row_q = q[0] - (1 if q[1] < p[1] else 0) - (1 if q[0] > p[0] else 0)
                qh = _code(q, _top(q, inner_row_q, padded), cols)
            if len(ring) > 4:
                faces[n, 0], faces[n, 1], faces[n, 2] = ph, qh, lattice + k
                n += 1
            elif i < 4 and i % 2 == 0:
                s = ring[(i + 2) % 4]
                sh = _code(s, _top(s, _beside(s, r0), padded) if wall else FLOOR, cols)
                faces[n, 0], faces[n, 1], faces[n, 2] = ph, qh, sh
                n += 1
            if wall and not padded[outer_row + 1, outer_col + 1]:
                n = _quad(faces, n, p0, q0, qh, ph)
            if outer_row < 0 or outer_row >= rows or outer_col < 0 or outer_col >= cols:
                pb, qb = _code(p, BOTTOM, cols), _code(q, BOTTOM, cols)
                n = _quad(faces, n, pb, qb, q0, p0)
                faces[n, 0], faces[n, 1], faces[n, 2] = qb, pb, lattice + len(rectangles)
                n += 1
    return faces[:n].copy()


@njit(cache=True)
def _ring(r0, c0, r1, c1, marked):  # type: ignore[no-untyped-def]
    """Return (m, 2) the marked points (row, col) around a rectangle, counter-clockwise with row = north."""
    ring = np.empty((2 * (r1 - r0 + c1 - c0), 2), np.int64)
    m = 0
    for c in range(c0, c1):
        if marked[r0, c]:
            ring[m, 0], ring[m, 1] = r0, c
            m += 1
    for r in range(r0, r1):
        if marked[r, c1]:
            ring[m, 0], ring[m, 1] = r, c1
            m += 1
    for c in range(c1, c0, -1):
        if marked[r1, c]:
            ring[m, 0], ring[m, 1] = r1, c
            m += 1
    for r in range(r1, r0, -1):
        if marked[r, c0]:
            ring[m, 0], ring[m, 1] = r, c0
            m += 1
    return ring[:m]


@njit(cache=True)
def _code(point, level, cols):  # type: ignore[no-untyped-def]
    return (point[0] * (cols + 1) + point[1]) * LEVELS + level


@njit(cache=True)
def _beside(point, r0):  # type: ignore[no-untyped-def]
    """Return the row of a rectangle's own cell at one of its corners."""
    return point[0] if point[0] == r0 else point[0] - 1


@njit(cache=True)
def _top(point, inner_row, padded):  # type: ignore[no-untyped-def]
    """Return a wall's upper level at a corner; of two that only touch there the northern has the twin."""
    r, c = point[0] + 1, point[1] + 1
    south_west, north_east = padded[r - 1, c - 1], padded[r, c]
    south_east, north_west = padded[r - 1, c], padded[r, c - 1]
    touching = south_west == north_east and south_east == north_west and south_west != south_east
    return TWIN_TOP if touching and inner_row == point[0] else TOP


@njit(cache=True)
def _quad(faces, n, a, b, c, d):  # type: ignore[no-untyped-def]
    faces[n, 0], faces[n, 1], faces[n, 2] = a, b, c
    faces[n + 1, 0], faces[n + 1, 1], faces[n + 1, 2] = a, c, d
    return n + 2
