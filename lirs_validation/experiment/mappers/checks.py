"""What a mapper hands over is looked at before anything is made of it."""

from __future__ import annotations

import math

import numpy as np

from lirs_wct.errors import MapperError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.mapper import CloudMapper, Mapper, MapperStats


def check_pose(estimate: object, stamp: float) -> None:
    """Tell whether an answer is a finite pose.

    Raises:
        MapperError: it is not; the message names the scan's stamp.
    """
    if not isinstance(estimate, Pose2):
        raise MapperError(
            f"update() must return a Pose2, got {kind_of(estimate)} for the scan at {stamp:.3f} s"
        )
    if not (math.isfinite(estimate.x) and math.isfinite(estimate.y) and math.isfinite(estimate.yaw)):
        raise MapperError(
            f"update() must return a finite pose, got x {estimate.x:g}, y {estimate.y:g}, "
            f"yaw {estimate.yaw:g} for the scan at {stamp:.3f} s"
        )


def final_trajectory(mapper: Mapper | CloudMapper) -> Trajectory:
    """Return the mapper's trajectory after the drive.

    Raises:
        MapperError: it is no trajectory, or not finite.
    """
    trajectory: object = mapper.trajectory()
    if not isinstance(trajectory, Trajectory):
        raise MapperError(f"trajectory() must return a Trajectory, got {kind_of(trajectory)}")
    wrong = ~(np.isfinite(trajectory.positions).all(axis=1) & np.isfinite(trajectory.quaternions).all(axis=1))
    if wrong.any():
        raise MapperError(f"trajectory() is not finite at {trajectory.stamps[wrong.argmax()]:.3f} s")
    return trajectory


def final_map(mapper: Mapper) -> OccupancyGrid:
    """Return the mapper's map after the drive.

    Raises:
        MapperError: it is no occupancy grid.
    """
    grid: object = mapper.map()
    if not isinstance(grid, OccupancyGrid):
        raise MapperError(f"map() must return an OccupancyGrid, got {kind_of(grid)}")
    return grid


def final_stats(mapper: Mapper | CloudMapper) -> MapperStats:
    """Return what the mapper counted.

    Raises:
        MapperError: it is no MapperStats.
    """
    stats: object = mapper.stats
    if not isinstance(stats, MapperStats):
        raise MapperError(f"stats must be a MapperStats, got {kind_of(stats)}")
    return stats


def kind_of(value: object) -> str:
    """Return the name of a value's type."""
    return type(value).__name__
