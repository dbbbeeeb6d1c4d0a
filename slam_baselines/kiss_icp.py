"""KISS-ICP in the authors' package, and the adapter of such an odometry.

Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP" (RA-L 2023).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import FloatArray, Imu, PointCloud, Pose3, Trajectory
from slam_baselines.mapper import MapperStats, Stopwatch

Register = Callable[[FloatArray, FloatArray], FloatArray]
"""Takes points (n, 3) in the sensor's frame, meters, and their times (n,) in the sweep, seconds, or none (0,)
of a sweep at one instant; returns the (4, 4) pose of the sensor at the sweep's stamp in its first frame."""


@dataclass(frozen=True, kw_only=True)
class KissIcpConfig(Checked, of="kiss-icp"):
    """Configurable parameters of KISS-ICP; the defaults are the authors'.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the map's voxels, meters; None = `max_range` / 100, as the authors do.
        threads: Threads of the registration; 1 = as every other mapper here, 0 = all.
    """

    max_range: float = limited(100.0, "(0, inf)", "m")
    min_range: float = limited(0.0, "[0, inf]")
    voxel_size: float | None = limited(None, "(0, inf)", "m")
    threads: int = limited(1, "[0, inf]")


def make_kiss_icp(config: KissIcpConfig) -> CloudOdometry:
    """Return KISS-ICP as a mapper."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    settings = KISSConfig()
    settings.data.max_range, settings.data.min_range = config.max_range, config.min_range
    voxel_size = config.max_range / 100 if config.voxel_size is None else config.voxel_size
    settings.mapping.voxel_size = voxel_size
    settings.registration.max_num_threads = config.threads
    odometry = KissICP(settings)

    def register(points: FloatArray, times: FloatArray) -> FloatArray:
        odometry.register_frame(points, times)
        return pose_at_start(odometry, times)

    return CloudOdometry(register)


def pose_at_start(odometry: Any, times: FloatArray) -> FloatArray:
    """Return the (4, 4) pose of the sensor when the last sweep began.

    KISS-ICP's pose is that of the last point: a rolling sweep began one motion earlier.
    """
    pose: FloatArray = odometry.last_pose
    return pose if len(times) == 0 else pose @ np.linalg.inv(odometry.last_delta)


class CloudOdometry:
    """A `CloudMapper` of a function that registers one sweep after the other.

    The inertial unit is not used. A sweep without any return leaves the pose as it was.
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
        stats = MapperStats(received=received, used=received - self._empty, skipped=skipped)
        return self._watch.add_to(stats)


def sweep_times(cloud: PointCloud) -> FloatArray:
    """Return (n,) seconds, or none (0,) of a sweep at one instant.

    KISS-ICP scales times by their span, and a span of 0 ends the whole process.
    """
    return cloud.time.astype(np.float64) if cloud.rolling else np.empty(0)


def pose_of(matrix: FloatArray) -> Pose3:
    """Return the pose of a homogeneous matrix (4, 4), meters.

    The quaternion is an eigenvector (Bar-Itzhack, "New Method for Extracting the Quaternion from a Rotation
    Matrix", JGCD 2000): another environment may have NumPy, but no SciPy.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3]
    corners = ((a - e - i, b + d, c + g, h - f), (0, e - a - i, f + h, c - g), (0, 0, i - a - e, d - b))
    K = np.array((*corners, (0, 0, 0, a + e + i)))
    x, y, z, w = np.linalg.eigh(K, UPLO="U")[1][:, -1] * 1.0
    return Pose3.from_arrays(matrix[:3, 3], np.array((w, x, y, z)) * (1.0 if w >= 0 else -1.0))
