"""Free ground of a world, on which routes plan their paths."""

from __future__ import annotations

import numpy as np

from lirs_validation.driving.path_driver import Path, PursuitConfig, speed_profile
from lirs_validation.driving.paths import area_round, nearest, path_weight, room_at, room_in, smooth_path
from lirs_wct import HeightField, OccupancyGrid, Pose2
from lirs_wct.arrays import FloatArray, IntArray


class FreeGround:
    """Free cells that are connected with a start pose, and the cost of driving there.

    Attributes:
        grid: frame of the cells.
        free: (rows, cols) whether the robot's center may be in a cell.
        room: (rows, cols) meters to the nearest blocked cell.
        weight: (rows, cols) cost of a meter in each cell.

    Args:
        grid: free cells = where the robot's center may be, world frame.
        start: any pose; only cells reachable from there are free.
        surface: the ground, for slower driving where it is steep.

    Raises:
        ConfigError: no cell is free.
    """

    def __init__(self, grid: OccupancyGrid, start: Pose2, surface: HeightField | None) -> None:
        self.grid, self._surface = grid, surface
        self.free = area_round(grid, start)
        self.room = room_in(self.free, grid.resolution)
        self.weight = path_weight(self.free, self.room)

    def nearest(self, x: float, y: float) -> IntArray:
        """Return (2,) row and column of the free cell nearest to a point."""
        return nearest(self.free, self.grid.cells((x, y)))

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Penalize cells round a point in the grid's frame: only the last resort leads there."""
        cells = np.argwhere(self.free)
        near = cells[np.linalg.norm(self.grid.centers(cells) - np.array(point), axis=1) < radius]
        self.weight[near[:, 0], near[:, 1]] += 50.0

    def smooth(self, points: FloatArray, keep: float, *, hold: int = 0) -> FloatArray:
        """Smooth a path of points (n, 2); see `smooth_path`."""
        return smooth_path(points, self.grid, self.room, keep=keep, hold=hold)

    def path(self, points: FloatArray, config: PursuitConfig, yaw: float | None = None) -> Path:
        """Return a path through points (n, 2) with speeds for the clearance and the slope."""
        height = None
        if self._surface is not None:
            height = np.nan_to_num(self._surface.height_at(points[:, 0], points[:, 1]))
        room = room_at(self.grid, self.room, points)
        return Path(points, speed_profile(points, room, config, height), yaw)
