"""Cells of a grid that paths begin from, and what a robot's heading makes dear."""

from __future__ import annotations

import math

import cv2
import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2


def area_round(grid: OccupancyGrid, start: Pose2) -> BoolArray:
    """Return (rows, cols) the connected free area nearest to a pose.

    Raises:
        ConfigError: no cell is free.
    """
    _, labels = cv2.connectedComponents(grid.free.astype(np.uint8), connectivity=4)
    if not labels.any():
        raise ConfigError("a tour needs at least one free cell, got a grid without any")
    row, col = nearest(labels > 0, grid.cells((start.x, start.y)))
    area: BoolArray = labels == labels[row, col]
    return area


def nearest(mask: BoolArray, cell: IntArray) -> IntArray:
    """Return (2,) row and column of the marked cell nearest to a cell, which may lie outside."""
    cells = np.argwhere(mask).astype(np.int64)
    found: IntArray = cells[int(np.argmin(np.sum((cells - cell) ** 2, axis=1)))]
    return found


def cells_ahead(grid: OccupancyGrid, free: BoolArray, start: Pose2, distance: float) -> IntArray:
    """Return (n, 2) rows and columns on a straight line: the free cell nearest to a pose, then on.

    Args:
        grid: the frame of the cells.
        free: (rows, cols); the line ends before the first cell that is not free.
        start: pose in the grid's frame; its yaw gives the direction.
        distance: meters.
    """
    first = nearest(free, grid.cells((start.x, start.y)))
    x, y = grid.centers(first).tolist()
    steps = np.arange(1, int(distance / grid.resolution) + 1) * grid.resolution
    line = Pose2(x, y, start.yaw).apply(np.column_stack((steps, np.zeros_like(steps))))
    cells = np.concatenate((first[None], grid.cells(line)))
    inside = np.all((cells >= 0) & (cells < np.array(grid.shape)), axis=1)
    held = np.where(inside[:, None], cells, 0)
    blocked = np.flatnonzero(~(inside & free[held[:, 0], held[:, 1]]))
    return cells[: blocked[0]] if len(blocked) else cells


def penalize_behind(weight: FloatArray, cell: IntArray, heading: float, radius: float) -> FloatArray:
    """Return weights with a penalty on the ground just behind a robot: a path then turns round in an arc.

    Args:
        weight: (rows, cols) cost of a meter in each cell.
        cell: (2,) row and column of the robot.
        heading: in the grid's own frame (columns along x), radians.
        radius: of the half disc behind it, cells.
    """
    reach = math.ceil(radius)
    low, high = np.maximum(cell - reach, 0), np.minimum(cell + reach + 1, weight.shape)
    box = (slice(low[0], high[0]), slice(low[1], high[1]))
    row, col = np.ogrid[box]
    distance = np.hypot(col - cell[1], row - cell[0])
    ahead = (col - cell[1]) * math.cos(heading) + (row - cell[0]) * math.sin(heading)
    changed = weight.copy()
    changed[box][(distance <= radius) & (ahead < -0.2 * distance)] *= 10.0
    return changed
