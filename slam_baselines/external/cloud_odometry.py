"""Adapter of a lidar odometry to a mapper of point clouds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import Imu, PointCloud, Pose3, Trajectory
from slam_baselines.mapper import MapperStats, Stopwatch

Register = Callable[[FloatArray, FloatArray], FloatArray]
"""Takes points (n, 3) in the sensor's frame, meters, and their times (n,) in the sweep, seconds, or none (0,)
of a sweep at one instant; returns the (4, 4) pose of the sensor at the sweep's stamp in its first frame."""


class CloudOdometry:
    """A `CloudMapper` of a function that registers one sweep after the other.

    The inertial unit is not used. A sweep without any return leaves the pose as it was.

    Args:
        register: the odometry.
    """

    reads_clouds = True
    lost = False

    def __init__(self, register: Register) -> None:
        self._register = register
        self._stamps: list[float] = []
        self._poses: list[Pose3] = []
        self._empty = 0
        self._watch = Stopwatch()

    def update(self, cloud: PointCloud, imu: Imu | None) -> Pose3:
        """Register a sweep; return `T_map_base` at its stamp."""
        started = self._watch.start()
        if len(cloud):
            T_first_sensor = pose_of(self._register(cloud.xyz.astype(np.float64), sweep_times(cloud)))
            pose = cloud.T_base_laser @ T_first_sensor @ cloud.T_base_laser.inverse()
        else:
            self._empty += 1
            pose = self._poses[-1] if self._poses else Pose3()
        self._stamps.append(cloud.stamp)
        self._poses.append(pose)
        self._watch.stop(started)
        return pose

    def trajectory(self) -> Trajectory:
        """Return the poses of all sweeps; an odometry corrects none of them later."""
        return Trajectory.from_poses(self._stamps, self._poses)

    @property
    def stats(self) -> MapperStats:
        """Sweeps and times."""
        received = len(self._poses)
        skipped = {"empty": self._empty} if self._empty else {}
        return MapperStats(
            received=received, used=received - self._empty, skipped=skipped, **self._watch.summary()
        )


def sweep_times(cloud: PointCloud) -> FloatArray:
    """Return (n,) seconds, or none (0,) of a sweep at one instant.

    KISS-ICP scales times by their span, and a span of 0 ends the whole process.
    """
    return cloud.time.astype(np.float64) if cloud.rolling else np.empty(0)


def pose_of(matrix: FloatArray) -> Pose3:
    """Return the pose of a homogeneous matrix (4, 4), meters."""
    return Pose3.from_arrays(matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_quat(scalar_first=True))
