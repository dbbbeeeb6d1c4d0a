"""A laser map's walls: exact cells for the LRF, few boxes for contact."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_wct.grid import OccupancyGrid
from lirs_wct.walls import WallGrid

Boxes = NDArray[np.int64]


def walls_of(grid: OccupancyGrid, height: float) -> WallGrid:
    """Return the occupied cells of a map as walls; unknown cells are floor.

    Raises:
        ConfigError: height is not above 0.
    """
    return WallGrid(grid.occupied, grid.resolution, grid.origin, height)


def merged_boxes(walls: WallGrid) -> Boxes:
    """Return (n, 4) rectangles row0, col0, row1, col1 (ends exclusive) that cover every wall cell once.

    Greedy: at the first cell that is left, the larger of two rectangles, one grown along the row
    first, one along the column first. The better of the map and its transpose is taken.
    """
    straight = _cover(walls.solid)
    turned = _cover(np.ascontiguousarray(walls.solid.T))[:, [1, 0, 3, 2]]
    return straight if len(straight) <= len(turned) else turned


def _cover(solid: NDArray[np.bool_]) -> Boxes:
    boxes: Boxes = _rectangles(solid.copy())
    return boxes


@njit(cache=True)
def _rectangles(left):  # type: ignore[no-untyped-def]
    """Take rectangles out of a mask (which is emptied) in the order of its rows."""
    rows, cols = left.shape
    boxes = np.empty((max(1, left.sum()), 4), np.int64)
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


@njit(cache=True)
def _grown(left, r, c, along_row):  # type: ignore[no-untyped-def]
    """Return the far corner of the rectangle at (r, c), grown along one axis first."""
    r1, c1 = r + 1, c + 1
    for axis in range(2):
        if (axis == 0) == along_row:
            while c1 < left.shape[1] and left[r:r1, c1].all():
                c1 += 1
        else:
            while r1 < left.shape[0] and left[r1, c:c1].all():
                r1 += 1
    return r1, c1
