"""A laser map's walls: exact cells for the LRF, few boxes for contact."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from lirs_wct.arrays import BoolArray, IntArray
from lirs_wct.errors import unknown_name
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.walls import WallGrid
from lirs_wct.sources.options import UNKNOWN, Unknown


def walls_of(grid: OccupancyGrid, height: float, unknown: Unknown = "floor") -> WallGrid:
    """Return the occupied cells of a map as walls.

    Args:
        grid: the map.
        height: of the walls, metres.
        unknown: what the cells of which the map knows nothing are: `floor`, `wall`, or `hole` (no floor).

    Raises:
        ConfigError: height is not above 0, `unknown` is none of these, or the whole map is a hole.
    """
    if unknown not in UNKNOWN:
        raise unknown_name("kind of unknown cell", unknown, UNKNOWN)
    solid = grid.occupied | ~grid.known if unknown == "wall" else grid.occupied
    hole = ~grid.known if unknown == "hole" and not grid.known.all() else None
    return WallGrid(solid, grid.resolution, grid.origin, height, hole)


def without_small_walls(grid: OccupancyGrid, min_cells: int) -> OccupancyGrid:
    """Return a map in which fewer than `min_cells` connected occupied cells are free.

    Cells that touch at a corner are connected.
    """
    occupied = grid.occupied
    _, label, stats, _ = cv2.connectedComponentsWithStats(occupied.astype(np.uint8), connectivity=8)
    small = (stats[:, cv2.CC_STAT_AREA] < min_cells)[label] & occupied
    if not small.any():
        return grid
    return OccupancyGrid.from_probability(
        np.where(small, 0.0, grid.probability), grid.resolution, grid.origin
    )


def level_floor(walls: WallGrid) -> HeightField:
    """Return level ground under the whole map, whatever its yaw."""
    low, high = walls.corners.min(axis=0), walls.corners.max(axis=0)
    width, depth = (high - low).tolist()
    return HeightField(np.zeros((2, 2), np.float32), (width, depth), (float(low[0]), float(low[1])))


def merged_boxes(walls: WallGrid) -> IntArray:
    """Return (n, 4) rectangles row0, col0, row1, col1 (ends exclusive) that cover every wall cell once."""
    return merged_rectangles(walls.solid)


def merged_rectangles(mask: BoolArray) -> IntArray:
    """Return (n, 4) rectangles row0, col0, row1, col1 (ends exclusive) that cover a mask once.

    Greedy: at the first cell that is left, the larger of two rectangles, one grown along the row
    first, one along the column first. The better of the mask and its transpose is taken.
    """
    straight = _cover(mask)
    turned = _cover(np.ascontiguousarray(mask.T))[:, [1, 0, 3, 2]]
    return straight if len(straight) <= len(turned) else turned


def _cover(solid: BoolArray) -> IntArray:
    boxes: IntArray = _rectangles(solid.copy())
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
