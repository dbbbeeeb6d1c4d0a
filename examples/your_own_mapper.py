"""A mapper of your own under test: dead reckoning here; put your method in the place of `update`.

lirs-wct validate examples/data/office.yaml --mapper hector,examples.your_own_mapper:DeadReckoning
"""

from __future__ import annotations

from lirs_wct import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory
from slam_baselines.front_end import KnownPoseMapper
from slam_baselines.mapper import MapperStats


class DeadReckoning:
    """Believes the odometry and draws the map with the package's own map update."""

    lost = False

    def __init__(self, resolution: float = 0.05) -> None:
        self._builder = KnownPoseMapper(resolution)
        self._stamps: list[float] = []
        self._poses: list[Pose2] = []
        self._start: Pose2 | None = None

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Take in a scan and return `T_map_base` at its stamp."""
        assert odometry is not None
        self._start = self._start or odometry
        T_map_base = self._start.inverse() @ odometry
        self._builder.update(scan, T_map_base, imu)
        self._stamps.append(scan.stamp)
        self._poses.append(T_map_base)
        return T_map_base

    def map(self) -> OccupancyGrid:
        """Return the map in the map frame."""
        return self._builder.map()

    def trajectory(self) -> Trajectory:
        """Return the final pose of every scan."""
        return Trajectory.from_poses(self._stamps, self._poses)

    @property
    def stats(self) -> MapperStats:
        """What was done so far."""
        return MapperStats(received=len(self._poses), used=len(self._poses))
