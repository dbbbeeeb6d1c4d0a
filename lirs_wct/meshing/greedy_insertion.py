"""Kernels of the greedy triangulation: which pixel is the worst, and the loop that inserts it.

Garland and Heckbert 1995, "Fast polygonal approximation of terrains and height fields", algorithm IV:
insert the pixel with the largest vertical error, restore the Delaunay property, look for the worst pixel
of the changed triangles, again.
"""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import Float32Array
from lirs_wct.kernels import njit
from lirs_wct.meshing.tin import BORDER, POINTS, STRIDE, TOP, TRIANGLES, WORST, Tin, insert_point, kernel

DONE, FULL = 0, 1
"""Why `refine` came back: the budget is met, or the arrays must grow."""


@kernel
def refine(tin: Tin, z: Float32Array, cols: int, max_error: float, max_faces: int) -> int:
    """Insert pixels until no error exceeds the budget or the closed solid would exceed the faces.

    Args:
        tin: changed in place; new, it is two triangles on four points.
        z: (rows * cols,) heights, row by row.
        cols: pixels of a row.
        max_error: in the unit of z.
        max_faces: of surface, skirt (2 for each border edge) and base (1 each).
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
        pixel = tin.link[STRIDE * t + WORST]
        tin.point[used[POINTS], 0], tin.point[used[POINTS], 1] = pixel // cols, pixel % cols
        used[POINTS] += 1
        old, new = insert_point(tin, t)
        for i in range(old):
            take(tin, tin.fan[i])
        for i in range(new):
            _search(tin, z, cols, tin.fan[i], budget)


@kernel
def _search(tin: Tin, z: Float32Array, cols: int, t: int, budget: int) -> None:
    """Find the worst pixel of a new triangle and put it into the queue if it is beyond the budget."""
    point, link, e = tin.point, tin.link, STRIDE * t
    a, b, c = link[e], link[e + 1], link[e + 2]
    error, pixel = worst_pixel(
        z, cols, point[a, 0], point[a, 1], point[b, 0], point[b, 1], point[c, 0], point[c, 1], budget
    )
    link[e + WORST] = pixel
    if pixel < 0:
        leave_out(tin, t)
    else:
        put(tin, t, error, budget)


@kernel
def worst_pixel(
    z: Float32Array, cols: int, ar: int, ac: int, br: int, bc: int, cr: int, cc: int, budget: int
) -> tuple[int, int]:
    """Return the largest vertical error of the plane through three nodes, and the pixel where it is.

    Rows are gone through between the long edge, from the top corner to the bottom one, and the two
    short ones. Corners are rows and columns; errors are of `order`.

    Returns:
        The error and row * columns + column, or the budget and -1 where no error exceeds it.
    """
    if br < ar:
        ar, ac, br, bc = br, bc, ar, ac
    if cr < br:
        br, bc, cr, cc = cr, cc, br, bc
    if br < ar:
        ar, ac, br, bc = br, bc, ar, ac
    det = (bc - ac) * (cr - ar) - (cc - ac) * (br - ar)
    if det * det == 1:
        # Pick's theorem: half a cell holds no pixel but its corners.
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
        # The slack keeps pixels that lie on the edge itself; the next is far farther away.
        west, east = int(np.ceil(min(x, y) - 1e-9)), int(np.floor(max(x, y) + 1e-9))
        start = za + per_row * (row - ar) + per_col * (west - ac)
        largest = _largest(z, row * cols + west, east - west + 1, start, per_col)
        if largest > most:
            most, first, count, height = largest, row * cols + west, east - west + 1, start
    return most, _place(z, first, count, height, per_col)


@njit(cache=True, fastmath=True, error_model="numpy", _nrt=False)
def _largest(z: Float32Array, first: int, count: int, start: float, step: float) -> int:
    """Return the largest difference of pixels of a row from a line that rises by `step` a pixel."""
    largest = 0
    for k in range(count):
        # Unsigned: an index that cannot be negative is not tested for it, and pixels go side by side.
        largest = max(largest, order(abs(start + step * k - z[np.uint64(first) + np.uint64(k)])))
    return largest


@kernel
def _place(z: Float32Array, first: int, count: int, start: float, step: float) -> int:
    """Return which of the pixels differs most from the line, -1 where there are none."""
    place, largest = -1, -1.0
    for k in range(count):
        error = abs(start + step * k - z[first + k])
        if error > largest:
            place, largest = first + k, error
    return place


_SHIFT = 52 - 7
"""Leaves a float64's exponent and the first seven bits of its fraction."""
_NOWHERE = -1
_FIRST = -2
"""First in bin k: -2 - k stands where the triangle before would."""


def count_bins(least: float, most: float) -> int:
    """Return how many bins errors from `least` to `most` need."""
    low, high = (int(np.float64(x).view(np.int64)) >> _SHIFT for x in (least, most))
    return high - low + 1


@kernel
def order(x: float) -> int:
    """Return the bits of a number that is not negative: they order as it does.

    The largest of integers is found four at a time, which compilers do not dare with floats.
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
    """Put a triangle into the bin of its error; both errors are of `order`."""
    k = min((error >> _SHIFT) - (least >> _SHIFT), len(tin.bins) - 1)
    after = tin.bins[k]
    tin.bins[k] = t
    tin.queue[2 * t], tin.queue[2 * t + 1] = _FIRST - k, after
    if after >= 0:
        tin.queue[2 * after] = t
    tin.used[TOP] = max(tin.used[TOP], k)


@kernel
def leave_out(tin: Tin, t: int) -> None:
    """Note of a new triangle that it is within the budget."""
    tin.queue[2 * t] = _NOWHERE


@kernel
def take(tin: Tin, t: int) -> None:
    """Take a triangle out of its bin, if it is in one."""
    before, after = tin.queue[2 * t], tin.queue[2 * t + 1]
    if before == _NOWHERE:
        return
    if after >= 0:
        tin.queue[2 * after] = before
    if before >= 0:
        tin.queue[2 * before + 1] = after
    else:
        tin.bins[_FIRST - before] = after
