"""Kernels of a Delaunay triangulation that grows: the data, and the insertion of one point.

A triangle is eight numbers side by side, one half of a cache line, since the insertions jump about:
three corners, three twins, its place in the heap, its worst pixel. Half-edge e = 8 t + k runs from
corner k of triangle t to the next; its twin is the same edge of the neighbour, or -1 on the border.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Ints = NDArray[np.int32]
Counts = NDArray[np.int64]

STRIDE, TWIN, SLOT, WORST = 8, 3, 6, 7
"""Numbers of a triangle, and where its twins, its place in the heap and its worst pixel begin."""
POINTS, TRIANGLES, BORDER, PENDING, QUEUED = range(5)
"""Places in `Tin.used`."""


class Tin(NamedTuple):
    """A growing triangulation; arrays are longer than what is in use, `used` says how much is.

    Attributes:
        point: (p, 2) row and column.
        link: (8 t,) triangles (see the module); corners counter-clockwise as the picture is seen. The
            worst pixel is row * columns + column, -1 while it is to be searched; the place is -1 where
            the triangle is within the budget.
        heap: (t,) triangles beyond the budget, the worst first.
        key: (t,) float64 errors of the triangles in the heap.
        pending: (t,) triangles changed since the last search.
        stack: (3 t,) half-edges to be tested for a flip.
        used: (5,) points, triangles, border edges, pending, queued.
    """

    point: Ints
    link: Ints
    heap: Ints
    key: NDArray[np.float64]
    pending: Ints
    stack: Ints
    used: Counts


@njit(cache=True)
def set_triangle(
    link: Ints, pending: Ints, used: Counts, e: int, a: int, b: int, c: int, ab: int, bc: int, ca: int
) -> int:
    """Make a triangle of three points and the twins of its edges; return e, its first half-edge."""
    link[e], link[e + 1], link[e + 2] = a, b, c
    link[e + TWIN], link[e + TWIN + 1], link[e + TWIN + 2] = ab, bc, ca
    if ab >= 0:
        link[ab + TWIN] = e
    if bc >= 0:
        link[bc + TWIN] = e + 1
    if ca >= 0:
        link[ca + TWIN] = e + 2
    if link[e + WORST] != -1:
        link[e + WORST] = -1
        pending[used[PENDING]] = e // STRIDE
        used[PENDING] += 1
    return e


@njit(cache=True)
def new_triangle(link: Ints, used: Counts) -> int:
    """Return the first half-edge of a triangle that is not yet in the heap nor pending."""
    e = int(STRIDE * used[TRIANGLES])
    used[TRIANGLES] += 1
    link[e + SLOT], link[e + WORST] = -1, 0
    return e


@njit(cache=True)
def insert_point(point: Ints, link: Ints, pending: Ints, stack: Ints, used: Counts, t: int) -> None:
    """Insert the newest point, which lies inside triangle t or on one of its edges."""
    p, e = used[POINTS] - 1, STRIDE * t
    for k in range(3):
        a, b = link[e + k], link[e + (k + 1) % 3]
        rise, run = point[b, 0] - point[a, 0], point[b, 1] - point[a, 1]
        if run * np.int64(point[p, 0] - point[a, 0]) == rise * np.int64(point[p, 1] - point[a, 1]):
            _insert_on_edge(point, link, pending, stack, used, e + k)
            return
    a, b, c = link[e], link[e + 1], link[e + 2]
    ab, bc, ca = link[e + TWIN], link[e + TWIN + 1], link[e + TWIN + 2]
    f, g = new_triangle(link, used), new_triangle(link, used)
    set_triangle(link, pending, used, e, a, b, p, ab, -1, -1)
    set_triangle(link, pending, used, f, b, c, p, bc, -1, e + 1)
    set_triangle(link, pending, used, g, c, a, p, ca, e + 2, f + 1)
    for edge in (e, f, g):
        _legalise(point, link, pending, stack, used, edge)


@njit(cache=True)
def _insert_on_edge(point: Ints, link: Ints, pending: Ints, stack: Ints, used: Counts, e: int) -> None:
    """Insert the newest point on half-edge e: the triangles beside it are halved."""
    p = used[POINTS] - 1
    t = e & -STRIDE
    after, before = t + (e - t + 1) % 3, t + (e - t + 2) % 3
    left, right, tip = link[e], link[after], link[before]
    h_after, h_before, other = link[after + TWIN], link[before + TWIN], link[e + TWIN]
    f = new_triangle(link, used)
    if other < 0:
        used[BORDER] += 1
        set_triangle(link, pending, used, t, tip, left, p, h_before, -1, -1)
        set_triangle(link, pending, used, f, right, tip, p, h_after, t + 2, -1)
        _legalise(point, link, pending, stack, used, t)
        _legalise(point, link, pending, stack, used, f)
        return
    u = other & -STRIDE
    o_after, o_before = u + (other - u + 1) % 3, u + (other - u + 2) % 3
    far, h_o_after, h_o_before = link[o_before], link[o_after + TWIN], link[o_before + TWIN]
    g = new_triangle(link, used)
    set_triangle(link, pending, used, t, tip, left, p, h_before, -1, -1)
    set_triangle(link, pending, used, u, left, far, p, h_o_after, -1, t + 1)
    set_triangle(link, pending, used, f, far, right, p, h_o_before, -1, u + 1)
    set_triangle(link, pending, used, g, right, tip, p, h_after, t + 2, f + 1)
    for edge in (t, u, f, g):
        _legalise(point, link, pending, stack, used, edge)


@njit(cache=True)
def _legalise(point: Ints, link: Ints, pending: Ints, stack: Ints, used: Counts, edge: int) -> None:
    """Flip the edge and those around it until each is Delaunay again."""
    depth = 1
    stack[0] = edge
    while depth > 0:
        depth -= 1
        a = stack[depth]
        b = link[a + TWIN]
        if b < 0:
            continue
        ta, tb = a & -STRIDE, b & -STRIDE
        a_next, a_last = ta + (a - ta + 1) % 3, ta + (a - ta + 2) % 3
        b_next, b_last = tb + (b - tb + 1) % 3, tb + (b - tb + 2) % 3
        right, left, near, far = link[a], link[a_next], link[a_last], link[b_last]
        if not _in_circle(point, near, right, left, far):
            continue
        h_al, h_ar = link[a_next + TWIN], link[a_last + TWIN]
        h_bl, h_br = link[b_last + TWIN], link[b_next + TWIN]
        set_triangle(link, pending, used, ta, near, far, left, -1, h_bl, h_al)
        set_triangle(link, pending, used, tb, far, near, right, ta, h_ar, h_br)
        stack[depth], stack[depth + 1] = tb + 2, ta + 1
        depth += 2


@njit(cache=True)
def _in_circle(point: Ints, a: int, b: int, c: int, p: int) -> bool:
    """Whether p lies inside the circle through a, b, c (exact for pictures up to 5,000 px a side)."""
    row, col = float(point[p, 0]), float(point[p, 1])
    dx, dy = point[a, 1] - col, point[a, 0] - row
    ex, ey = point[b, 1] - col, point[b, 0] - row
    fx, fy = point[c, 1] - col, point[c, 0] - row
    ap, bp, cp = dx * dx + dy * dy, ex * ex + ey * ey, fx * fx + fy * fy
    det = dx * (ey * cp - bp * fy) - dy * (ex * cp - bp * fx) + ap * (ex * fy - ey * fx)
    return bool(det < 0)
