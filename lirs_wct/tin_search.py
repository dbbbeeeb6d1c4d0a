"""Kernels of the greedy triangulation: which pixel is the worst, and the loop that inserts it.

Garland and Heckbert 1995, "Fast polygonal approximation of terrains and height fields", algorithm IV:
insert the pixel with the largest vertical error, restore the Delaunay property by flips, look for the
worst pixel of the changed triangles, again.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_wct.tin import (
    BORDER,
    PENDING,
    POINTS,
    QUEUED,
    SLOT,
    STRIDE,
    TRIANGLES,
    WORST,
    Counts,
    Ints,
    Tin,
    insert_point,
)

DONE, FULL = 0, 1
"""Why `refine` came back: the budget is met, or the arrays must grow."""


@njit(cache=True)
def refine(tin: Tin, z: NDArray[np.float32], max_error: float, max_faces: int) -> int:
    """Insert pixels until no error exceeds the budget or the closed solid would exceed the faces.

    Args:
        tin: changed in place.
        z: (rows, cols) heights.
        max_error: in the unit of z.
        max_faces: of surface, skirt (2 for each border edge) and base (1 each).
    """
    point, link, heap, key, pending, stack, used = tin
    cols = z.shape[1]
    _search_pending(point, link, heap, key, pending, used, z, max_error)
    while used[QUEUED] > 0:
        # One insertion adds two triangles, or one and a border edge.
        if used[TRIANGLES] + 3 * used[BORDER] + 4 > max_faces:
            return DONE
        if used[TRIANGLES] + 2 > len(heap) or used[POINTS] + 1 > len(point):
            return FULL
        pixel = link[STRIDE * heap[0] + WORST]
        point[used[POINTS], 0], point[used[POINTS], 1] = pixel // cols, pixel % cols
        used[POINTS] += 1
        insert_point(point, link, pending, stack, used, heap[0])
        _search_pending(point, link, heap, key, pending, used, z, max_error)
    return DONE


@njit(cache=True)
def _search_pending(
    point: Ints,
    link: Ints,
    heap: Ints,
    key: NDArray[np.float64],
    pending: Ints,
    used: Counts,
    z: NDArray[np.float32],
    max_error: float,
) -> None:
    """Find the worst pixel of every changed triangle and put it in its place in the heap."""
    for i in range(used[PENDING]):
        t = pending[i]
        e = STRIDE * t
        a, b, c = link[e], link[e + 1], link[e + 2]
        error, pixel = worst_pixel(
            z, point[a, 0], point[a, 1], point[b, 0], point[b, 1], point[c, 0], point[c, 1]
        )
        link[e + WORST] = pixel
        _queue(link, heap, key, used, t, error, error > max_error)
    used[PENDING] = 0


@njit(cache=True)
def _queue(
    link: Ints, heap: Ints, key: NDArray[np.float64], used: Counts, t: int, error: float, wanted: bool
) -> None:
    """Put a triangle where its error belongs in the heap, or take it out where it is not wanted."""
    i, n = link[STRIDE * t + SLOT], used[QUEUED]
    if not wanted:
        if i < 0:
            return
        link[STRIDE * t + SLOT] = -1
        n -= 1
        used[QUEUED] = n
        if i == n:
            return
        t, error = heap[n], key[n]
    elif i < 0:
        i = n
        n += 1
        used[QUEUED] = n
    while i > 0 and key[(i - 1) // 2] < error:
        heap[i], key[i] = heap[(i - 1) // 2], key[(i - 1) // 2]
        link[STRIDE * heap[i] + SLOT] = i
        i = (i - 1) // 2
    while True:
        child = 2 * i + 1
        if child >= n:
            break
        if child + 1 < n and key[child + 1] > key[child]:
            child += 1
        if key[child] <= error:
            break
        heap[i], key[i] = heap[child], key[child]
        link[STRIDE * heap[i] + SLOT] = i
        i = child
    heap[i], key[i] = t, error
    link[STRIDE * t + SLOT] = i


@njit(cache=True, fastmath=True)
def _largest(z: NDArray[np.float32], row: int, i: int, j: int, start: float, step: float) -> float:
    """Return the largest difference of heights i to j of a row from a line; heights are finite."""
    largest = 0.0
    for k in range(j - i):
        largest = max(largest, abs(start + step * k - z[row, i + k]))
    return largest


@njit(cache=True)
def worst_pixel(
    z: NDArray[np.float32], ar: int, ac: int, br: int, bc: int, cr: int, cc: int
) -> tuple[float, int]:
    """Return the largest vertical error of the plane through three nodes, and the pixel where it is.

    The corners a, b, c (row, then column) come counter-clockwise as the picture is seen.
    """
    za = float(z[ar, ac])
    zb, zc = float(z[br, bc]) - za, float(z[cr, cc]) - za
    ab_r, ab_c, ac_r, ac_c = float(br - ar), float(bc - ac), float(cr - ar), float(cc - ac)
    det = ab_c * ac_r - ac_c * ab_r
    per_col, per_row = (zb * ac_r - zc * ab_r) / det, (zc * ab_c - zb * ac_c) / det
    slope_ab = ab_c / ab_r if br != ar else 0.0
    slope_bc = float(cc - bc) / float(cr - br) if cr != br else 0.0
    slope_ca = ac_c / ac_r if cr != ar else 0.0
    left, right = float(min(ac, bc, cc)), float(max(ac, bc, cc))
    cols = z.shape[1]
    most, where = 0.0, ar * cols + ac
    for row in range(min(ar, br, cr), max(ar, br, cr) + 1):
        low, high = left, right
        # An edge that runs down the picture has the triangle to its east, one that runs up to its west.
        x = ac + (row - ar) * slope_ab
        low, high = (max(low, x) if br > ar else low), (min(high, x) if br < ar else high)
        x = bc + (row - br) * slope_bc
        low, high = (max(low, x) if cr > br else low), (min(high, x) if cr < br else high)
        x = cc + (row - cr) * slope_ca
        low, high = (max(low, x) if ar > cr else low), (min(high, x) if ar < cr else high)
        # The slack keeps pixels that lie on the edge itself; the next is at least 1/5000 away.
        i, j = int(np.ceil(low - 1e-9)), int(np.floor(high + 1e-9)) + 1
        start = za + per_row * (row - ar) + per_col * (i - ac)
        if j - i > 16 and _largest(z, row, i, j, start, per_col) <= most:
            continue
        for col in range(i, j):
            error = abs(start + per_col * (col - i) - z[row, col])
            if error > most:
                most, where = error, row * cols + col
    if where == ar * cols + ac or where == br * cols + bc or where == cr * cols + cc:
        return 0.0, where
    return most, where
