"""KISS-SLAM in the authors' package, which needs Open3D.

Guadagnino et al., "KISS-SLAM: A Simple, Robust, and Accurate 3D LiDAR SLAM System With Enhanced
Generalization Capabilities" (IROS 2025).
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.field_validators import require_above
from lirs_wct.geometry import Imu, PointCloud, Pose3, Trajectory
from slam_baselines.external.cloud_odometry import pose_of, sweep_times
from slam_baselines.external.kiss_icp import KissIcpConfig, configure
from slam_baselines.mapper import MapperStats, Stopwatch


@dataclass(frozen=True, kw_only=True)
class KissSlamConfig(KissIcpConfig):
    """Configurable parameters of KISS-SLAM; the defaults are the authors'.

    Attributes:
        splitting_distance: meters from the start of a local map at which the next one begins. Loops are
            closed between local maps: in a world smaller than this there is only one.

    Raises:
        ConfigError: a value is not legal.
    """

    mapper: ClassVar[str] = "kiss-slam"
    splitting_distance: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_above(self, 0, "splitting_distance", of=self.mapper, unit="m", finite=True)


class KissSlamMapper:
    """KISS-SLAM as a `CloudMapper`."""

    reads_clouds = True
    lost = False

    def __init__(self, config: KissSlamConfig) -> None:
        from kiss_slam.config.config import KissSLAMConfig
        from kiss_slam.slam import KissSLAM

        settings = KissSLAMConfig()
        odometry = settings.odometry
        configure(odometry.preprocessing, odometry.mapping, odometry.registration, config)
        settings.local_mapper.splitting_distance = config.splitting_distance
        self._slam = KissSLAM(settings)
        self._stamps: list[float] = []
        self._T_base_sensor = Pose3()
        self._to_start: list[FloatArray] = []
        self._received = 0
        self._final: Trajectory | None = None
        self._watch = Stopwatch()

    def update(self, cloud: PointCloud, imu: Imu | None) -> Pose3:
        """Register a sweep; return the present estimate of `T_map_base` at its stamp."""
        started = self._watch.start()
        self._received += 1
        self._T_base_sensor = cloud.T_base_laser
        if len(cloud):
            times, odometry = sweep_times(cloud), self._slam.odometry
            with _silent():
                self._slam.process_scan(cloud.xyz.astype(np.float64), times)
            self._to_start.append(np.linalg.inv(odometry.last_delta) if len(times) else np.eye(4))
            self._stamps.append(cloud.stamp)
            self._final = None
        T_map_local = self._slam.local_map_graph.last_keypose
        pose = self._base_pose(T_map_local @ self._slam.odometry.last_pose, -1)
        self._watch.stop(started)
        return pose

    def trajectory(self) -> Trajectory:
        """Return all poses after closing the last local map and optimizing the graph."""
        if self._final is None:
            self._final = self._optimize()
        return self._final

    @property
    def stats(self) -> MapperStats:
        """Sweeps, times, local maps and loops."""
        slam, used = self._slam, len(self._stamps)
        counts = {"local_maps": len(slam.get_keyposes()), "loops": len(slam.get_closures())}
        skipped = {"empty": self._received - used} if self._received > used else {}
        return MapperStats(
            received=self._received, used=used, skipped=skipped, counts=counts, **self._watch.summary()
        )

    def _optimize(self) -> Trajectory:
        if not self._stamps:
            return Trajectory.from_poses([], list[Pose3]())
        with _silent():
            self._slam.generate_new_node()
            matrices, _ = self._slam.fine_grained_optimization()
        poses = [self._base_pose(matrix, k) for k, matrix in enumerate(matrices)]
        return Trajectory.from_poses(self._stamps, poses)

    def _base_pose(self, T_first_sensor: FloatArray, k: int) -> Pose3:
        """Return `T_map_base` at the start of sweep k, from the sensor's pose at its end."""
        if not self._to_start:
            return Pose3()
        T = pose_of(T_first_sensor @ self._to_start[k])
        return self._T_base_sensor @ T @ self._T_base_sensor.inverse()


@contextmanager
def _silent() -> Iterator[None]:
    """Suppress KISS-SLAM's prints to the standard output."""
    with redirect_stdout(io.StringIO()):
        yield
