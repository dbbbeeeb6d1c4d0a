"""Cover of a mask of cells by few rectangles."""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import BoolArray, IntArray
from lirs_wct.kernels import njit


def merged_rectangles(mask: BoolArray) -> IntArray:
    """Return (n, 4) disjoint rectangles that cover a mask: row0, col0, row1, col1 (ends exclusive).

    Greedy: at the first uncovered cell, two rectangles grow, one along the row first and one along the column
    first; the larger one is taken. The result is the smaller cover of the mask and its transpose.
    """
    straight = _cover(mask)
    turned = _cover(np.ascontiguousarray(mask.T))[:, [1, 0, 3, 2]]
    return straight if len(straight) <= len(turned) else turned


def _cover(solid: BoolArray) -> IntArray:
    boxes: IntArray = _rectangles(solid.copy())
    return boxes


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
