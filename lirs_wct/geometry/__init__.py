"""Geometric values: poses, scans, grids, height fields, meshes, walls, trajectories.

The values that a mapper takes and returns are imported from here.
"""

from lirs_wct.geometry.grid import OccupancyGrid, WallGrid
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory, wrap_angle
from lirs_wct.geometry.scan import Imu, ImuReadings, LaserScan, PointCloud

__all__ = [
    "Imu",
    "ImuReadings",
    "LaserScan",
    "OccupancyGrid",
    "PointCloud",
    "Pose2",
    "Pose3",
    "Trajectory",
    "WallGrid",
    "wrap_angle",
]
