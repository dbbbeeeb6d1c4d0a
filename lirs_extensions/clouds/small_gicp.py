"""Odometry of the registration in the package small_gicp.

Koide, "small_gicp: Efficient and Parallel Algorithms for Point Cloud Registration" (JOSS 2024).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lirs_extensions.clouds.timed_odometry import TimedOdometry, TimedSystem, deskew, matrix_of
from lirs_wct.arrays import FloatArray
from lirs_wct.checks import Checked, limited
from lirs_wct.geometry import PointCloud
from slam_baselines.kiss_icp import sweep_times

VOXEL_LIFETIME = 10**6
"""Sweeps for which a voxel is kept that no sweep meets: the robot comes back."""


@dataclass(frozen=True, kw_only=True)
class SmallGicpConfig(Checked, of="small-gicp"):
    """Configurable parameters of the odometry; the defaults follow the package's odometry benchmark.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the voxels of map and scan, meters.
        max_distance: largest distance between a point and its voxel, meters.
        neighbors: number of points that give the covariance of a point.
        threads: Threads of the registration; 1 = as every other mapper here.
    """

    max_range: float = limited(100.0, "(0, inf)", "m")
    min_range: float = limited(0.3, "[0, inf]", "m")
    voxel_size: float = limited(0.25, "(0, inf)", "m")
    max_distance: float = limited(1.0, "(0, inf)", "m")
    neighbors: int = limited(10, "[5, inf]")
    threads: int = limited(1, "[1, inf]")


class SmallGicp(TimedSystem):
    """Odometry of small_gicp's registration as a `TimedSystem`.

    VGICP registers each sweep against a map of Gaussian voxels (Koide et al., "Voxelized GICP for Fast and
    Accurate 3D Point Cloud Registration", ICRA 2021). Constant velocity predicts its pose and takes the
    robot's motion out of a rolling sweep.
    """

    def __init__(self, config: SmallGicpConfig) -> None:
        import small_gicp

        self._gicp, self._config = small_gicp, config
        self._map = small_gicp.GaussianVoxelMap(config.voxel_size)
        self._map.set_lru(horizon=VOXEL_LIFETIME)
        self._pose, self._motion = np.eye(4), np.eye(4)
        self._mount: FloatArray | None = None

    def register(self, cloud: PointCloud) -> list[tuple[float, FloatArray]]:
        """Register a sweep; return the pose of its middle."""
        config, gicp = self._config, self._gicp
        times = sweep_times(cloud)
        ranges = np.linalg.norm(cloud.xyz, axis=1)
        kept = (ranges >= config.min_range) & (ranges <= config.max_range)
        points = deskew(cloud.xyz.astype(np.float64), times, self._motion)[kept]
        scan, _ = gicp.preprocess_points(points, config.voxel_size, config.neighbors, config.threads)
        if self._mount is None:
            self._mount = self._pose = matrix_of(cloud.T_base_laser)
        else:
            options = {"max_correspondence_distance": config.max_distance, "num_threads": config.threads}
            found = gicp.align(self._map, scan, self._pose @ self._motion, **options).T_target_source
            self._pose, self._motion = found, np.linalg.inv(self._pose) @ found
        self._map.insert(scan, self._pose)
        middle = cloud.stamp + (0.5 * float(times.max()) if len(times) else 0.0)
        return [(middle, self._pose @ np.linalg.inv(self._mount))]


def make_small_gicp(config: SmallGicpConfig) -> TimedOdometry:
    """Return the odometry as a mapper."""
    return TimedOdometry(SmallGicp(config))
