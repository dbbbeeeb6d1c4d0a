"""Closed solid of a laser map: walls, floor, slab.

The plan of a laser map is cut into rectangles of wall, floor and hole. Every corner of a rectangle becomes a
vertex of all rectangles that it touches, so that no edge ends in the middle of another. Two walls, or two
parts of the floor, may touch only at a corner. Then the northern one has separate vertices there, a
millimeter inside its cell. Thus an edge never joins more than two triangles, also in an STL, whose readers
merge equal positions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.geometry import BoolArray, FloatArray, IntArray, WallGrid, njit
from lirs_wct.geometry.mesh import TriangleMesh

SLAB = 0.1
"""Thickness of the floor, meters."""
VOID, GROUND, WALL = 0, 1, 2
"""Kinds of cells."""
CellKinds = NDArray[np.int8]
BOTTOM, TWIN_BOTTOM, FLOOR, TWIN_FLOOR, TOP, TWIN_TOP, LEVELS = 0, 1, 2, 3, 4, 5, 6
"""Levels of a corner of the plan; the twin is the vertex of a second body."""
GAP = 0.001
"""Distance along both axes between vertices of two bodies touching at a corner, meters; at most 0.1 cell."""


def wall_mesh(walls: WallGrid) -> TriangleMesh:
    """Return walls, floor and slab as one watertight solid; z = 0 is the floor."""
    boxes = [merged_rectangles(walls.solid), merged_rectangles(walls.floor)]
    # One layout: otherwise numba would compile the kernel again for Fortran order.
    rectangles = np.ascontiguousarray(np.concatenate(boxes))
    is_wall = np.repeat((True, False), [len(b) for b in boxes])
    holes = np.empty((0, 4), np.int64) if walls.hole is None else merged_rectangles(walls.hole)
    kind = np.where(walls.solid, np.int8(WALL), np.int8(GROUND))
    if walls.hole is not None:
        kind[walls.hole] = VOID
    # The points of the lattice that are corners of rectangles.
    marked = np.zeros((walls.shape[0] + 1, walls.shape[1] + 1), np.bool_)
    r0, c0, r1, c1 = np.concatenate((rectangles, holes)).T
    for row, col in ((r0, c0), (r0, c1), (r1, c0), (r1, c1)):
        marked[row, col] = True
    kind = np.pad(kind, 1)
    codes = _triangles(rectangles, is_wall, kind, marked, len(holes) > 0)
    used, faces = np.unique(codes, return_inverse=True)
    vertices = _decode(used, rectangles, is_wall, kind, walls)
    return TriangleMesh(vertices, faces.reshape(-1, 3).astype(np.int32))


def _decode(
    used: IntArray, rectangles: IntArray, is_wall: BoolArray, kind: CellKinds, walls: WallGrid
) -> FloatArray:
    """Return the (n, 3) positions of codes: lattice points at a level, then rectangle centers."""
    rows, cols = walls.shape
    lattice = (rows + 1) * (cols + 1) * LEVELS
    heights = np.array((-SLAB, -SLAB, 0.0, 0.0, walls.height, walls.height))
    corner, middle = used[used < lattice], used[used >= lattice] - lattice
    point, level = np.divmod(corner, LEVELS)
    row, col = np.divmod(point, cols + 1)
    # Middles of the upper sides, of the whole underside, of each underside.
    boxes = np.concatenate((rectangles, [[0, 0, rows, cols]], rectangles))[middle]
    upper, lower = np.where(is_wall, walls.height, 0.0), np.full(len(rectangles) + 1, -SLAB)
    # Twins move into their own cell.
    twin, least = level % 2 == 1, np.where(level == TWIN_TOP, WALL, GROUND)
    east = np.where(kind[row + 1, col + 1] >= least, 1.0, -1.0)
    apart = np.stack((east, np.ones_like(east)), axis=-1) * min(GAP / walls.resolution, 0.1)
    lattice_plan = np.stack((col, row), axis=-1) + np.where(twin[:, None], apart, 0.0)
    plan = np.concatenate((lattice_plan, (boxes[:, [1, 0]] + boxes[:, [3, 2]]) / 2))
    xy = walls.origin.apply(plan * walls.resolution)
    return np.column_stack((xy, np.concatenate((heights[level], np.concatenate((upper, lower))[middle]))))


@njit
def _triangles(
    rectangles: IntArray, is_wall: BoolArray, kind: CellKinds, marked: BoolArray, holed: bool
) -> IntArray:
    """Return (m, 3) vertex codes of the triangles; `kind` is padded with void cells."""
    rows, cols = marked.shape[0] - 1, marked.shape[1] - 1
    base = (rows + 1) * (cols + 1) * LEVELS + len(rectangles)
    room = 0
    for r0, c0, r1, c1 in rectangles:
        room += int(marked[r0, c0:c1].sum() + marked[r1, c0:c1].sum())
        room += int(marked[r0:r1, c0].sum() + marked[r0:r1, c1].sum()) + 4
    faces = np.empty((6 * room + 2 * (rows + cols) + 8, 3), np.int64)
    n = 0
    for k in range(len(rectangles)):
        r0, c0, r1, c1 = rectangles[k]
        ring = _ring(r0, c0, r1, c1, marked)
        m = len(ring)
        low, floor, top = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(m, np.int64)
        for i in range(m):
            # At a corner the row of the rectangle's own cell; other points have no twin.
            row = ring[i, 0] if ring[i, 0] == r0 else ring[i, 0] - 1
            second = _twin(ring[i], row, kind, GROUND)
            low[i] = _code(ring[i], TWIN_BOTTOM if second else BOTTOM, cols)
            floor[i] = _code(ring[i], TWIN_FLOOR if second else FLOOR, cols)
            top[i] = floor[i]
            if is_wall[k]:
                top[i] = _code(ring[i], TWIN_TOP if _twin(ring[i], row, kind, WALL) else TOP, cols)
        n = _cap(faces, n, top, base - len(rectangles) + k)
        if holed:
            n = _cap(faces, n, low[::-1], base + 1 + k)
        for i in range(m):
            j = (i + 1) % m
            beside = _beside(ring[i], ring[j], kind)
            if is_wall[k] and beside != WALL:
                n = _quad(faces, n, floor[i], floor[j], top[j], top[i])
            if beside == VOID:
                n = _quad(faces, n, low[i], low[j], floor[j], floor[i])
                if not holed:
                    faces[n, 0], faces[n, 1], faces[n, 2] = low[j], low[i], base
                    n += 1
    return faces[:n].copy()


@njit
def _ring(r0: int, c0: int, r1: int, c1: int, marked: BoolArray) -> IntArray:
    """Return the (m, 2) marked points (row, col) around a rectangle.

    Counter-clockwise, with rows counted northward.
    """
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


@njit
def _code(point: IntArray, level: int, cols: int) -> Any:
    return (point[0] * (cols + 1) + point[1]) * LEVELS + level


@njit
def _beside(p: IntArray, q: IntArray, kind: CellKinds) -> Any:
    """Return the kind of the cell right of p -> q; `kind` is padded."""
    if q[1] != p[1]:
        return kind[p[0], p[1] + 1] if q[1] > p[1] else kind[p[0] + 1, p[1]]
    return kind[p[0] + 1, p[1] + 1] if q[0] > p[0] else kind[p[0], p[1]]


@njit
def _twin(point: IntArray, row: int, kind: CellKinds, least: int) -> Any:
    """Whether a body has the twin at a corner.

    Of two bodies that touch only there, the northern one has it.
    """
    r, c = point[0] + 1, point[1] + 1
    south_west, north_east = kind[r - 1, c - 1] >= least, kind[r, c] >= least
    south_east, north_west = kind[r - 1, c] >= least, kind[r, c - 1] >= least
    touching = south_west == north_east and south_east == north_west and south_west != south_east
    return touching and row == point[0]


@njit
def _cap(faces: IntArray, n: int, ring: IntArray, middle: int) -> int:
    """Fill a ring with triangles: two, or a fan around its middle."""
    m = len(ring)
    for i in range(m):
        if m > 4:
            faces[n, 0], faces[n, 1], faces[n, 2] = ring[i], ring[(i + 1) % m], middle
            n += 1
        elif i % 2 == 0:
            faces[n, 0], faces[n, 1], faces[n, 2] = ring[i], ring[i + 1], ring[(i + 2) % m]
            n += 1
    return n


@njit
def _quad(faces: IntArray, n: int, a: int, b: int, c: int, d: int) -> int:
    faces[n, 0], faces[n, 1], faces[n, 2] = a, b, c
    faces[n + 1, 0], faces[n + 1, 1], faces[n + 1, 2] = a, c, d
    return n + 2


def merged_rectangles(mask: BoolArray) -> IntArray:
    """Return (n, 4) disjoint rectangles that cover a mask: row0, col0, row1, col1 (ends exclusive).

    Greedy: at the first uncovered cell, two rectangles grow, one along the row first and one along the column
    first; the larger one is taken. The result is the smaller cover of the mask and its transpose.
    """
    straight: IntArray = _rectangles(mask.copy())
    turned: IntArray = _rectangles(mask.T.copy())[:, [1, 0, 3, 2]]
    return straight if len(straight) <= len(turned) else turned


@njit
def _rectangles(left: BoolArray) -> IntArray:
    """Cover a mask by rectangles in row order; the mask is cleared."""
    rows, cols = left.shape
    boxes = np.empty((max(1, int(left.sum())), 4), np.int64)
    count = 0
    for r in range(rows):
        for c in range(cols):
            if not left[r, c]:
                continue
            wide = _grown(left, r, c, True)
            tall = _grown(left, r, c, False)
            if (wide[0] - r) * (wide[1] - c) >= (tall[0] - r) * (tall[1] - c):
                r1, c1 = wide
            else:
                r1, c1 = tall
            left[r:r1, c:c1] = False
            boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = r, c, r1, c1
            count += 1
    return boxes[:count].copy()


@njit
def _grown(left: BoolArray, r: int, c: int, along_row: bool) -> tuple[int, int]:
    """Return the far corner of a rectangle grown from (r, c)."""
    r1, c1 = r + 1, c + 1
    for axis in range(2):
        if (axis == 0) == along_row:
            while c1 < left.shape[1] and _all(left, r, c1, r1, c1 + 1):
                c1 += 1
        else:
            while r1 < left.shape[0] and _all(left, r1, c, r1 + 1, c1):
                r1 += 1
    return r1, c1


@njit
def _all(left: BoolArray, r0: int, c0: int, r1: int, c1: int) -> bool:
    """Whether all cells of a rectangle are uncovered; faster than `all` of a slice."""
    for r in range(r0, r1):
        for c in range(c0, c1):
            if not left[r, c]:
                return False
    return True
