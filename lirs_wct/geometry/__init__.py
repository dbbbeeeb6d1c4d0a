"""Geometric values: poses, scans, grids, height fields, meshes, walls, trajectories.

The values that a mapper takes and returns, the types of their arrays, and the decorator of kernels on these
are imported from here.
"""

from lirs_wct.arrays import BoolArray, ByteArray, Float32Array, FloatArray, Int32Array, IntArray, njit
from lirs_wct.geometry.grid import (
    FREE,
    OCCUPIED,
    HeightField,
    OccupancyGrid,
    WallGrid,
    fewer_nodes,
    mask_at,
    nearest_values,
    resample,
    sample_surface,
)
from lirs_wct.geometry.pose import (
    Pose2,
    Pose3,
    Trajectory,
    Viewpoint,
    compose_poses,
    covariance_fault,
    in_axes_of,
    relative_poses,
    wrap_angle,
    wrap_angles,
)
from lirs_wct.geometry.scan import FARTHEST, POINT, Imu, ImuReadings, LaserScan, PointCloud

__all__ = [
    "FARTHEST",
    "FREE",
    "OCCUPIED",
    "POINT",
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
    "compose_poses",
    "covariance_fault",
    "fewer_nodes",
    "in_axes_of",
    "mask_at",
    "nearest_values",
    "njit",
    "relative_poses",
    "resample",
    "sample_surface",
    "wrap_angle",
    "wrap_angles",
]
