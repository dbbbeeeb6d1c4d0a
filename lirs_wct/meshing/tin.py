"""A Delaunay triangulation that grows by one point after another: its arrays, and the insertion.

Bowyer 1981, "Computing Dirichlet tessellations", and Watson 1981: the triangles whose circumcircle holds
the new point make a hole around it without a point inside, so that they hang together like a tree; a fan
from the new point to the hole's rim closes it again.

A triangle is eight numbers side by side, half a cache line, since insertions jump about: three corners,
three twins, its worst pixel, and one to spare. Half-edge e = 8 t + k runs from corner k of triangle t to
the next corner, counter-clockwise as the picture is seen; its twin is the same edge of the neighbor, or
-1 on the border.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import Int32Array, IntArray
from lirs_wct.kernels import njit

STRIDE, TWIN, WORST = 8, 3, 6
"""Numbers of a triangle, and where its twins and its worst pixel begin."""
POINTS, TRIANGLES, BORDER, TOP = range(4)
"""Places in `Tin.used`."""

# The kernels own no memory; numba's counting of the arrays in and out of every call took a third of the time.
kernel = njit(cache=True, error_model="numpy", _nrt=False)


class Tin(NamedTuple):
    """A growing triangulation; arrays are longer than what is in use, `used` says how much is.

    Attributes:
        point: (p, 2) row and column.
        link: (8 t,) triangles (see the module); the worst pixel is row * columns + column.
        queue: (2 t,) for each triangle the one before and after it in its bin (see `tin_queue`).
        bins: (b,) the first triangle of each bin, -1 if empty.
        fan: (t,) triangles of the last insertion.
        rim: (2 t + 1,) corners around the hole, each followed by the half-edge outside.
        stack: (t + 3,) half-edges of the hole still to be looked across.
        used: (4,) points, triangles, border edges, and the highest bin that may hold something.
    """

    point: Int32Array
    link: Int32Array
    queue: Int32Array
    bins: Int32Array
    fan: Int32Array
    rim: Int32Array
    stack: Int32Array
    used: IntArray


@kernel
def insert_point(tin: Tin, t: int) -> tuple[int, int]:
    """Insert the newest point, which lies inside triangle t or on one of its edges.

    Returns:
        How many triangles of `fan` were there before, and how many it has now.
    """
    k = _border_edge(tin, t)
    old, new = _dig(tin, t, k)
    for i in range(new - old):
        tin.fan[old + i] = tin.used[TRIANGLES] + i
    tin.used[TRIANGLES] += new - old
    _fill(tin, new)
    if k >= 0:
        # The fan is open: its first and its last edge are halves of the border edge.
        tin.used[BORDER] += 1
        tin.link[STRIDE * tin.fan[0] + TWIN + 2] = -1
        tin.link[STRIDE * tin.fan[new - 1] + TWIN + 1] = -1
    return old, new


@kernel
def _border_edge(tin: Tin, t: int) -> int:
    """Return which edge of t is on the border and holds the newest point, -1 if none."""
    p = tin.used[POINTS] - 1
    for k in range(3):
        e = STRIDE * t + k
        if tin.link[e + TWIN] < 0:
            a, b = tin.link[e], tin.link[_after(e)]
            for axis in range(2):
                # Border edges are parallel to the axes.
                if tin.point[a, axis] == tin.point[b, axis] == tin.point[p, axis]:
                    return k
    return -1


@kernel
def _dig(tin: Tin, t: int, k: int) -> tuple[int, int]:
    """Find the hole around the newest point and its rim, counter-clockwise; edge k of t is left out.

    Returns:
        Triangles of the hole, edges of the rim.
    """
    link, fan, rim, stack = tin.link, tin.fan, tin.rim, tin.stack
    p = tin.used[POINTS] - 1
    row, col = np.int64(tin.point[p, 0]), np.int64(tin.point[p, 1])
    last = STRIDE * t + max(k, 0)
    first = _after(last)
    fan[0] = t
    stack[0], stack[1], stack[2] = last, _after(first), first
    holes, edges, depth, least = 1, 0, 3, (1 if k >= 0 else 0)
    while depth > least:
        depth -= 1
        inside = stack[depth]
        outside = link[inside + TWIN]
        u = outside & -STRIDE
        if outside >= 0 and _in_circle(tin.point, link[u], link[u + 1], link[u + 2], row, col):
            fan[holes] = u // STRIDE
            holes += 1
            next_edge = _after(outside)
            stack[depth], stack[depth + 1] = _after(next_edge), next_edge
            depth += 2
        else:
            rim[2 * edges], rim[2 * edges + 1] = link[inside], outside
            edges += 1
    rim[2 * edges] = link[last] if k >= 0 else rim[0]
    return holes, edges


@kernel
def _fill(tin: Tin, edges: int) -> None:
    """Join the newest point to each edge of the rim: triangles one beside the other, all around."""
    link, fan, rim = tin.link, tin.fan, tin.rim
    p = tin.used[POINTS] - 1
    e = STRIDE * fan[edges - 1]
    for i in range(edges):
        before, e = e, STRIDE * fan[i]
        outside = rim[2 * i + 1]
        link[e], link[e + 1], link[e + 2] = rim[2 * i], rim[2 * i + 2], p
        link[e + TWIN], link[e + TWIN + 2] = outside, before + 1
        link[before + TWIN + 1] = e + 2
        if outside >= 0:
            link[outside + TWIN] = e


@kernel
def _after(e: int) -> int:
    """Return the half-edge that follows in the triangle: 0, 1, 2 become 1, 2, 0, two bits each."""
    t = e & -STRIDE
    return t + (0b00_10_01 >> 2 * (e - t) & 3)


@kernel
def _in_circle(point: Int32Array, a: int, b: int, c: int, row: int, col: int) -> bool:
    """Whether a pixel lies inside the circle through a, b, c: exact for sides below 29,000 px."""
    dx, dy = point[a, 1] - col, point[a, 0] - row
    ex, ey = point[b, 1] - col, point[b, 0] - row
    fx, fy = point[c, 1] - col, point[c, 0] - row
    ap, bp, cp = dx * dx + dy * dy, ex * ex + ey * ey, fx * fx + fy * fy
    det = dx * (ey * cp - bp * fy) - dy * (ex * cp - bp * fx) + ap * (ex * fy - ey * fx)
    return bool(det < 0)
