"""Greedy triangulation of a height field: a Delaunay triangulation that grows by its worst pixel.

Garland and Heckbert 1995, "Fast polygonal approximation of terrains and height fields", algorithm IV:
insert the pixel with the largest vertical error, restore the Delaunay property, find the worst pixel of each
changed triangle, repeat. Where all pixels are within the budget, insert pixels where an edge still differs
from the triangulated height field, which has MuJoCo's diagonals: then the budget holds between pixels too.

Bowyer 1981, "Computing Dirichlet tessellations", and Watson 1981: remove the triangles whose circumcircle
contains the new point. They are connected and leave a hole without a point inside. A fan from the new point
to the hole's rim closes it.

A triangle is eight adjacent numbers, half a cache line, because insertions access triangles in random order:
three corners, three twins, the pixel to insert next, and one unused. Half-edge e = 8 t + k runs from corner
k of triangle t to the next corner, counter-clockwise as the picture is seen. Its twin is the same edge of the
neighbor, or -1 on the border.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import BoolArray, Float32Array, Int32Array, IntArray, njit

STRIDE, TWIN, WORST = 8, 3, 6
"""Numbers per triangle, and offsets of its twins and of its worst pixel."""
POINTS, TRIANGLES, BORDER, TOP = range(4)
"""Indices into `Tin.used`."""

# The kernels own no memory; numba's counting of the arrays in and out of every call took a third of the time.
kernel = njit(cache=True, _nrt=False)
DONE, FULL = 0, 1
"""Results of `refine`: the budget is met, or the arrays must grow."""
SHIFT = 52 - 7
"""Shift that keeps a float64's exponent and the first seven bits of its fraction."""
_NOWHERE = -1
_FIRST = -2
"""First in bin k: -2 - k replaces the index of the previous triangle."""


class Tin(NamedTuple):
    """A growing triangulation; `used` counts the used elements of the longer arrays.

    Attributes:
        point: (p, 2) row and column.
        link: (8 t,) triangles (see the module); the worst pixel is row * columns + column.
        queue: (2 t,) the previous and next triangle of each triangle in its bin of errors.
        bins: (b,) the first triangle of each bin, -1 if empty.
        taken: (pixels,) whether a pixel is a point.
        fan: (t,) triangles of the last insertion.
        rim: (2 t + 1,) corners around the hole, each followed by the half-edge outside.
        stack: (t + 3,) half-edges of the hole that are still to be crossed.
        used: (4,) points, triangles, border edges, and the highest bin that may be non-empty.
    """

    point: Int32Array
    link: Int32Array
    queue: Int32Array
    bins: Int32Array
    taken: BoolArray
    fan: Int32Array
    rim: Int32Array
    stack: Int32Array
    used: IntArray


@kernel
def insert_point(tin: Tin, t: int) -> tuple[int, int]:
    """Insert the newest point in or on triangle t; return old and new triangles of `fan`."""
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
    """Return the border edge of t that contains the newest point, -1 if none."""
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
    """Find the hole around the newest point; return its size and its rim's.

    The rim leaves out edge k of t.
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
    """Join the newest point to each edge of the rim by a triangle."""
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
    """Return the next half-edge in the triangle: 0, 1, 2 become 1, 2, 0."""
    t = e & -STRIDE
    return t + (0b00_10_01 >> 2 * (e - t) & 3)


@kernel
def _in_circle(point: Int32Array, a: int, b: int, c: int, row: int, col: int) -> bool:
    """Whether a pixel lies inside the circle through a, b, c; exact below 29,000 px."""
    dx, dy = point[a, 1] - col, point[a, 0] - row
    ex, ey = point[b, 1] - col, point[b, 0] - row
    fx, fy = point[c, 1] - col, point[c, 0] - row
    ap, bp, cp = dx * dx + dy * dy, ex * ex + ey * ey, fx * fx + fy * fy
    det = dx * (ey * cp - bp * fy) - dy * (ex * cp - bp * fx) + ap * (ex * fy - ey * fx)
    return bool(det < 0)


@kernel
def refine(tin: Tin, z: Float32Array, cols: int, max_error: float, max_faces: int) -> int:
    """Insert pixels until the budget or the limit of the solid's faces is reached.

    A new triangulation has two triangles on four points. The heights z (rows * cols,) run row by row. The
    faces are those of surface, skirt (2 per border edge) and base (1 per border edge).
    """
    used, budget = tin.used, order(max_error)
    if used[POINTS] == 4:
        for t in range(2):
            _search(tin, z, cols, t, budget)
    while True:
        t = worst(tin)
        # One insertion adds two triangles, or one and a border edge.
        if t < 0 or used[TRIANGLES] + 3 * used[BORDER] + 4 > max_faces:
            return DONE
        if used[TRIANGLES] + 2 > len(tin.fan) or used[POINTS] + 1 > len(tin.point):
            return FULL
        _insert_pixel(tin, z, cols, t, budget)


@kernel
def _insert_pixel(tin: Tin, z: Float32Array, cols: int, t: int, budget: int) -> None:
    """Insert the pixel that triangle t needs, and search the changed triangles."""
    pixel = tin.link[STRIDE * t + WORST]
    kept = True
    take(tin, t)
    leave_out(tin, t)
    # A pixel next to t may have become a point since t was searched.
    if not tin.taken[pixel]:
        row, col = pixel // cols, pixel % cols
        tin.point[tin.used[POINTS], 0], tin.point[tin.used[POINTS], 1] = row, col
        tin.used[POINTS] += 1
        tin.taken[pixel] = True
        old, new = insert_point(tin, _locate(tin, t, row, col))
        for i in range(old):
            take(tin, tin.fan[i])
            kept = kept and tin.fan[i] != t
        for i in range(new):
            _search(tin, z, cols, tin.fan[i], budget)
    if kept:
        _search(tin, z, cols, t, budget)


@kernel
def _locate(tin: Tin, t: int, row: int, col: int) -> int:
    """Return the triangle that contains a pixel, by a walk from triangle t."""
    k = 0
    while k < 3:
        e = STRIDE * t + k
        a, b = tin.link[e], tin.link[_after(e)]
        ar, ac = np.int64(tin.point[a, 0]), np.int64(tin.point[a, 1])
        # East is +column, north is -row: negative where the pixel is to the right of the edge.
        if (tin.point[b, 1] - ac) * (ar - row) - (ar - tin.point[b, 0]) * (col - ac) < 0:
            t, k = tin.link[e + TWIN] // STRIDE, 0
        else:
            k += 1
    return t


@kernel
def _search(tin: Tin, z: Float32Array, cols: int, t: int, budget: int) -> None:
    """Find the pixel that a triangle needs next, and queue the triangle."""
    point, link, e = tin.point, tin.link, STRIDE * t
    a, b, c = link[e], link[e + 1], link[e + 2]
    error, pixel = worst_pixel(
        z, cols, point[a, 0], point[a, 1], point[b, 0], point[b, 1], point[c, 0], point[c, 1], budget
    )
    if pixel < 0:
        # The lowest bin: pixels go first.
        error = budget
        for k in range(3):
            if pixel < 0:
                a, b = link[e + k], link[_after(e + k)]
                pixel = crossed_pixel(
                    z, cols, tin.taken, point[a, 0], point[a, 1], point[b, 0], point[b, 1], budget
                )
    link[e + WORST] = pixel
    if pixel < 0:
        leave_out(tin, t)
    else:
        put(tin, t, error, budget)


@kernel
def crossed_pixel(
    z: Float32Array, cols: int, taken: BoolArray, ar: int, ac: int, br: int, bc: int, budget: int
) -> int:
    """Return the pixel next to the largest error along an edge of the triangulation.

    The difference of two triangulated surfaces is largest at a corner of one of them or where their edges
    cross: here rows, columns, and diagonals from south-west to north-east. The result is the nearer end of
    the crossed segment that is not a point yet, or -1 where no error exceeds the budget.
    """
    down, right = br - ar, bc - ac
    largest, pixel = budget, -1
    za = float(z[ar * cols + ac])
    slope = float(z[br * cols + bc]) - za
    for axis in range(3):
        count = abs(down if axis == 0 else right if axis == 1 else down + right)
        for i in range(1, count):
            row, col = ar + down * i / count, ac + right * i / count
            first = int(np.floor(row + 1e-9)) * cols + int(np.floor(col + 1e-9))
            along, second = row - np.floor(row + 1e-9), first + cols
            if axis == 0:
                along, second = col - np.floor(col + 1e-9), first + 1
            elif axis == 2:
                first, second = first + 1, first + cols
            if along < 1e-9:
                continue
            error = order(abs(za + slope * i / count - (1 - along) * z[first] - along * z[second]))
            if error > largest and not (taken[first] and taken[second]):
                nearer = second if along > 0.5 else first
                largest, pixel = error, first + second - nearer if taken[nearer] else nearer
    return pixel


@kernel
def worst_pixel(
    z: Float32Array, cols: int, ar: int, ac: int, br: int, bc: int, cr: int, cc: int, budget: int
) -> tuple[int, int]:
    """Return the largest vertical error of the plane through three nodes, and its pixel.

    Each row lies between the long edge, from the top corner to the bottom corner, and one of the two short
    edges. Corners are rows and columns; errors are results of `order`. The pixel is row * columns + column;
    where no error exceeds the budget, the result is the budget and -1.
    """
    if br < ar:
        ar, ac, br, bc = br, bc, ar, ac
    if cr < br:
        br, bc, cr, cc = cr, cc, br, bc
    if br < ar:
        ar, ac, br, bc = br, bc, ar, ac
    det = (bc - ac) * (cr - ar) - (cc - ac) * (br - ar)
    if det * det == 1:
        # Pick's theorem: half a cell contains no pixel except its corners.
        return budget, -1
    za = float(z[ar * cols + ac])
    zb, zc = z[br * cols + bc] - za, z[cr * cols + cc] - za
    per_col, per_row = (zb * (cr - ar) - zc * (br - ar)) / det, (zc * (bc - ac) - zb * (cc - ac)) / det
    long = (cc - ac) / (cr - ar)
    upper = (bc - ac) / (br - ar) if br > ar else 0.0
    lower = (cc - bc) / (cr - br) if cr > br else 0.0
    most, first, count, height = budget, 0, 0, 0.0
    for row in range(ar, cr + 1):
        x = ac + (row - ar) * long
        y = ac + (row - ar) * upper if row < br else bc + (row - br) * lower
        # The slack keeps pixels on the edge itself; the next pixel is much farther away.
        west, east = int(np.ceil(min(x, y) - 1e-9)), int(np.floor(max(x, y) + 1e-9))
        start = za + per_row * (row - ar) + per_col * (west - ac)
        largest = _largest(z, row * cols + west, east - west + 1, start, per_col)
        if largest > most:
            most, first, count, height = largest, row * cols + west, east - west + 1, start
    return most, _place(z, first, count, height, per_col)


@njit(fastmath=True, _nrt=False)
def _largest(z: Float32Array, first: int, count: int, start: float, step: float) -> int:
    """Return the largest difference of a row's pixels from a line."""
    largest = 0
    for k in range(count):
        # Unsigned: the compiler omits the test for negative indices and vectorizes.
        largest = max(largest, order(abs(start + step * k - z[np.uint64(first) + np.uint64(k)])))
    return largest


@kernel
def _place(z: Float32Array, first: int, count: int, start: float, step: float) -> int:
    """Return the pixel with the largest difference from the line, -1 if there is none."""
    place, largest = -1, -1.0
    for k in range(count):
        error = abs(start + step * k - z[first + k])
        if error > largest:
            place, largest = first + k, error
    return place


@kernel
def align_diagonals(tin: Tin) -> None:
    """Split whole cells from south-west to north-east, as the height field is; twins become invalid."""
    link, point = tin.link, tin.point
    for e in range(STRIDE * tin.used[TRIANGLES]):
        if e % STRIDE >= TWIN or link[e + TWIN] < 0:
            continue
        f = link[e + TWIN]
        a, b, c, d = link[e], link[_after(e)], link[_after(_after(e))], link[_after(_after(f))]
        down, right = point[a, 0] - point[b, 0], point[a, 1] - point[b, 1]
        # The twin of an edge of a cell that was split again may be another edge by now.
        whole = link[f] == b and link[_after(f)] == a
        for axis in range(2):
            middle = point[a, axis] + point[b, axis] == point[c, axis] + point[d, axis]
            whole = whole and middle and abs(point[c, axis] - point[d, axis]) == 1
        if down * right == 1 and whole:
            t, u = e & -STRIDE, f & -STRIDE
            link[t], link[t + 1], link[t + 2] = c, a, d
            link[u], link[u + 1], link[u + 2] = d, b, c


@kernel
def order(x: float) -> int:
    """Return the bits of a non-negative number as an integer of the same order.

    Compilers vectorize the maximum of integers, but not of floats.
    """
    return int(np.float64(x).view(np.int64))


@kernel
def worst(tin: Tin) -> int:
    """Return a triangle of the highest bin, -1 if all are empty."""
    top = tin.used[TOP]
    while top > 0 and tin.bins[top] < 0:
        top -= 1
    tin.used[TOP] = top
    return int(tin.bins[top])


@kernel
def put(tin: Tin, t: int, error: int, least: int) -> None:
    """Put a triangle into the bin of its error; both errors are results of `order`."""
    k = min((error >> SHIFT) - (least >> SHIFT), len(tin.bins) - 1)
    after = tin.bins[k]
    tin.bins[k] = t
    tin.queue[2 * t], tin.queue[2 * t + 1] = _FIRST - k, after
    if after >= 0:
        tin.queue[2 * after] = t
    tin.used[TOP] = max(tin.used[TOP], k)


@kernel
def leave_out(tin: Tin, t: int) -> None:
    """Mark a new triangle as within the budget."""
    tin.queue[2 * t] = _NOWHERE


@kernel
def take(tin: Tin, t: int) -> None:
    """Remove a triangle from its bin, if it is in one."""
    before, after = tin.queue[2 * t], tin.queue[2 * t + 1]
    if before == _NOWHERE:
        return
    if after >= 0:
        tin.queue[2 * after] = before
    if before >= 0:
        tin.queue[2 * before + 1] = after
    else:
        tin.bins[_FIRST - before] = after
