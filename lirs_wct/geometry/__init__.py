"""Geometric values: poses, scans, grids, height fields, meshes, walls, trajectories.

The values that a mapper takes and returns, and the types of their arrays, are imported from here.
"""

from lirs_wct.arrays import BoolArray, ByteArray, Float32Array, FloatArray, Int32Array, IntArray
from lirs_wct.geometry.grid import FREE, OCCUPIED, HeightField, OccupancyGrid, WallGrid, mask_at
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory, Viewpoint, wrap_angle
from lirs_wct.geometry.scan import Imu, ImuReadings, LaserScan, PointCloud

__all__ = [
    "FREE",
    "OCCUPIED",
    "BoolArray",
    "ByteArray",
    "Float32Array",
    "FloatArray",
    "HeightField",
    "Imu",
    "ImuReadings",
    "Int32Array",
    "IntArray",
    "LaserScan",
    "OccupancyGrid",
    "PointCloud",
    "Pose2",
    "Pose3",
    "Trajectory",
    "Viewpoint",
    "WallGrid",
    "mask_at",
    "wrap_angle",
]
