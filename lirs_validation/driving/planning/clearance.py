"""How much room cells leave, and what it costs to drive where there is little."""

from __future__ import annotations

import cv2
import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry.grid import OccupancyGrid

COMFORTABLE = 0.6
"""Distance to blocked cells that a path likes to keep, meters."""
NARROW = 6.0
"""How many times longer a meter feels where there is no room at all."""


def room_in(free: BoolArray, resolution: float) -> FloatArray:
    """Return (rows, cols) meters from each free cell to the nearest other or the border; 0 where not free."""
    padded = np.pad(free, 1).astype(np.uint8)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return np.where(free, distance * resolution, 0.0)


def path_weight(
    free: BoolArray, room: FloatArray, comfortable: float = COMFORTABLE, narrow: float = NARROW
) -> FloatArray:
    """Return (rows, cols) what a meter costs: 1 where there is room, up to `narrow`, inf where not free."""
    lack = 1 - np.minimum(room / comfortable, 1.0)
    return np.where(free, 1 + (narrow - 1) * lack**2, np.inf)


def room_at(grid: OccupancyGrid, room: FloatArray, points: FloatArray) -> FloatArray:
    """Return (n,) the room at points (n, 2) in the grid's frame; that of the nearest cell outside."""
    cells = np.clip(grid.cells(points), 0, np.array(room.shape) - 1)
    return room[cells[:, 0], cells[:, 1]]
