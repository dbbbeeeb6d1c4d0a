"""Shortest paths over the cells of a grid (Dijkstra 1959), as far as somebody needs them."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2


@dataclass(frozen=True)
class Reach:
    """What a search found.

    Attributes:
        cost: (rows, cols) cost from the sources in metres times weight; inf = not reached.
        parent: (rows, cols) flat index of the cell before; -1 at a source.
    """

    cost: FloatArray
    parent: IntArray

    def path(self, cell: tuple[int, int]) -> IntArray:
        """Return (n, 2) rows and columns from a source to a reached cell, both included."""
        cols = self.parent.shape[1]
        flat = cell[0] * cols + cell[1]
        chain = [flat]
        parents = self.parent.ravel()
        while parents[flat] >= 0:
            flat = int(parents[flat])
            chain.append(flat)
        return np.stack(np.divmod(np.array(chain[::-1], dtype=np.int64), cols), axis=-1)


def search(
    weight: FloatArray,
    sources: IntArray,
    resolution: float,
    *,
    goals: BoolArray | None = None,
    slack: float = 0.0,
    limit: float = math.inf,
) -> Reach:
    """Search outward from cells, to the eight neighbours, without cutting the corners of blocked cells.

    Args:
        weight: (rows, cols) cost of a metre in each cell; inf = blocked.
        sources: (n, 2) rows and columns where the cost is 0.
        resolution: metres a cell.
        goals: stop once no cell within `slack` beyond the nearest of these is left.
        slack: in units of the cost.
        limit: stop at this cost.
    """
    wanted = np.zeros(weight.shape, np.bool_) if goals is None else goals
    cost, parent = _dijkstra(
        np.ascontiguousarray(weight, dtype=np.float64), sources, resolution, wanted, slack, limit
    )
    return Reach(cost, parent)


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
        distance: metres.
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
        weight: (rows, cols) cost of a metre in each cell.
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


@njit(cache=True)
def _dijkstra(
    weight: FloatArray, sources: IntArray, resolution: float, goals: BoolArray, slack: float, limit: float
) -> tuple[FloatArray, IntArray]:
    rows, cols = weight.shape
    cost = np.full((rows, cols), np.inf)
    parent = np.full((rows, cols), -1, np.int64)
    heap = [(0.0, np.int64(-1))]
    heap.pop()
    for k in range(len(sources)):
        r, c = sources[k, 0], sources[k, 1]
        if cost[r, c] > 0 and weight[r, c] < np.inf:
            cost[r, c] = 0.0
            heapq.heappush(heap, (0.0, r * cols + c))
    while len(heap) > 0:
        here, flat = heapq.heappop(heap)
        r, c = flat // cols, flat % cols
        if here > cost[r, c]:
            continue
        if here > limit:
            break
        if goals[r, c]:
            limit = min(limit, here + slack)
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                i, j = r + dr, c + dc
                if (dr == 0 and dc == 0) or i < 0 or j < 0 or i >= rows or j >= cols:
                    continue
                if weight[i, j] == np.inf or weight[r, j] == np.inf or weight[i, c] == np.inf:
                    continue
                step = resolution * (1.4142135623730951 if dr != 0 and dc != 0 else 1.0)
                there = here + step * 0.5 * (weight[r, c] + weight[i, j])
                if there < cost[i, j]:
                    cost[i, j] = there
                    parent[i, j] = flat
                    heapq.heappush(heap, (there, i * cols + j))
    # Cells that were seen but not settled are no answer.
    for r in range(rows):
        for c in range(cols):
            if cost[r, c] > limit:
                cost[r, c] = np.inf
    return cost, parent
