"""Isolate a mapper: read-only inputs, exceptions become MapperError."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import FrozenInstanceError, astuple, replace
from typing import Any, NoReturn, cast

import numpy as np

from lirs_validation.config import DRIVERS, Attitude, MapConfig, RunConfig, driver_parts
from lirs_validation.experiment.mapper_loading import MapperSpec
from lirs_validation.interrupts import is_interrupt
from lirs_wct.errors import ConfigError, MapperError, WctError
from lirs_wct.geometry.cloud import PointCloud
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.mapper import CloudMapper, Mapper, MapperStats, reads_clouds, requires_odometry

READ_ONLY = re.compile(r"read-?only", re.IGNORECASE)
"""Matches messages of NumPy and Numba about a write into a read-only array."""


class MapperGuard:
    """Common base of the guards of planar and cloud mappers."""

    def __init__(self, mapper: Mapper | CloudMapper, name: str) -> None:
        """Guard a mapper; messages call it by a name."""
        self._mapper, self._name = mapper, name

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory.

        Raises:
            MapperError: the mapper fails, or gives no trajectory, or none that is finite.
        """
        try:
            return final_trajectory(self._mapper)
        except BaseException as error:
            mapper_failure(self._name, "trajectory()", error)

    @property
    def stats(self) -> MapperStats:
        """Statistics of the mapper.

        Raises:
            MapperError: the mapper fails, or gives no MapperStats.
        """
        try:
            return final_stats(self._mapper)
        except BaseException as error:
            mapper_failure(self._name, "stats", error)

    @property
    def lost(self) -> bool:
        """Whether the mapper does not know its place.

        Raises:
            MapperError: the mapper fails.
        """
        try:
            return bool(self._mapper.lost)
        except BaseException as error:
            mapper_failure(self._name, "lost", error)


class GuardedMapper(MapperGuard):
    """Guard of a planar mapper: inputs are copies, each failure becomes a `MapperError`.

    A copy is read-only, so that a mapper that writes into it learns so; and it is a copy, so that one that
    makes it writable again changes nothing but its own.
    """

    _mapper: Mapper

    def __init__(self, mapper: Mapper, name: str) -> None:
        """Guard a mapper; messages call it by a name."""
        super().__init__(mapper, name)
        self._mount, self._mount_copy = Pose3(), Pose3()
        self.requires_odometry = requires_odometry(mapper)

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Hand over copies; return the mapper's answer, a finite pose.

        Raises:
            MapperError: the mapper fails, writes into its inputs, or returns another type.
        """
        stamp = scan.stamp
        try:
            if scan.T_base_laser is not self._mount:
                self._mount, self._mount_copy = scan.T_base_laser, replace(scan.T_base_laser)
            copy = scan_copy(scan, self._mount_copy)
            estimate = self._mapper.update(copy, pose_copy(odometry), imu_copy(imu))
        except BaseException as error:
            mapper_failure(self._name, "update()", error, f" for the scan at {stamp:.3f} s")
        check_pose(estimate, stamp)
        return estimate

    def map(self) -> OccupancyGrid:
        """Return the mapper's map.

        Raises:
            MapperError: the mapper fails, or gives no occupancy grid.
        """
        try:
            return final_map(self._mapper)
        except BaseException as error:
            mapper_failure(self._name, "map()", error)


def mapper_failure(name: str, part: str, error: BaseException, where: str = "") -> NoReturn:
    """Raise the error for a mapper's failure.

    A Ctrl-C and our own errors stay unchanged.
    """
    if is_interrupt(error):
        raise KeyboardInterrupt from error
    if isinstance(error, WctError):
        raise error
    kind = ": ".join(filter(None, (type(error).__name__, str(error))))
    if isinstance(error, FrozenInstanceError) or READ_ONLY.search(str(error)):
        raise MapperError(
            f"mapper {name!r}: {part} writes into what it was given{where} ({kind}); "
            "what it is given is read-only, change a copy"
        ) from error
    raise MapperError(f"mapper {name!r}: {part} failed{where}: {kind}") from error


def scan_copy(scan: LaserScan, mount: Pose3) -> LaserScan:
    """Return a read-only copy of a scan, with a copy of its mount."""
    ranges, s = scan.ranges.copy(), scan
    ranges.flags.writeable = False
    return LaserScan(
        ranges,
        s.angle_min,
        s.angle_increment,
        s.range_min,
        s.range_max,
        s.stamp,
        mount,
        s.time_increment,
    )


def pose_copy(pose: Pose2 | None) -> Pose2 | None:
    """Return a copy of a pose."""
    return None if pose is None else Pose2(pose.x, pose.y, pose.yaw)


def imu_copy(imu: Imu | None) -> Imu | None:
    """Return a copy of an inertial reading.

    Its vectors are immutable tuples.
    """
    if imu is None:
        return None
    return Imu(imu.roll, imu.pitch, imu.angular_velocity, imu.linear_acceleration, imu.stamp)


def check_pose(estimate: object, stamp: float) -> None:
    """Check that an answer is a finite planar pose.

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
    """Return the mapper's statistics, checked.

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


def with_attitude(mapper: Mapper, attitude: Attitude) -> Mapper:
    """Return the mapper itself (`imu`), or one without attitude (`none`)."""
    return mapper if attitude == "imu" else WithoutAttitude(mapper)


class WithoutAttitude:
    """Mapper without inertial readings: None, as on a robot without an IMU.

    A reading less its roll and pitch would not do: its accelerations have the direction of gravity, its
    rates add up to the attitude, and zeros would say that the robot is level. The gyro's heading is in the
    odometry, which the mapper keeps.
    """

    def __init__(self, mapper: Mapper) -> None:
        """Take the attitude from a mapper."""
        self._mapper = mapper
        self.requires_odometry = requires_odometry(mapper)

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Hand over scan and odometry; return the mapper's answer."""
        return self._mapper.update(scan, odometry, None)

    def map(self) -> OccupancyGrid:
        """Return the mapper's map."""
        return self._mapper.map()

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory."""
        return self._mapper.trajectory()

    @property
    def stats(self) -> MapperStats:
        """Statistics of the mapper."""
        return self._mapper.stats

    @property
    def lost(self) -> bool:
        """Whether the mapper does not know its place."""
        return self._mapper.lost


class GuardedCloudMapper(MapperGuard):
    """Guard of a cloud mapper: inputs are copies, each failure becomes a `MapperError`.

    Args:
        mapper: that is guarded.
        name: of the mapper in messages.
        attitude: whether it is given inertial readings.
    """

    reads_clouds = True
    _mapper: CloudMapper

    def __init__(self, mapper: CloudMapper, name: str, *, attitude: bool = True) -> None:
        super().__init__(mapper, name)
        self._attitude = attitude

    def update(self, cloud: PointCloud, imu: Imu | None) -> Pose3:
        """Hand over copies; return the mapper's answer, a finite pose.

        Raises:
            MapperError: the mapper fails, writes into its inputs, or returns another type.
        """
        stamp = cloud.stamp
        try:
            estimate = self._mapper.update(cloud_copy(cloud), imu_copy(imu) if self._attitude else None)
        except BaseException as error:
            mapper_failure(self._name, "update()", error, f" for the scan at {stamp:.3f} s")
        check_pose3(estimate, stamp)
        return estimate


def guard_mapper(
    mapper: Any, config: RunConfig | MapConfig | MapperSpec
) -> GuardedMapper | GuardedCloudMapper:
    """Return the guard of a mapper, with the configured attitude."""
    if reads_clouds(mapper):
        return GuardedCloudMapper(mapper, config.mapper, attitude=config.attitude == "imu")
    return GuardedMapper(with_attitude(cast("Mapper", mapper), config.attitude), config.mapper)


def check_sensors(mapper: Any, config: RunConfig) -> None:
    """Check that a run's lidar and driver suit its mapper.

    Any lidar suits a planar mapper: of one with rings it gets the ring nearest the horizon.

    Raises:
        ConfigError: a mapper of point clouds has a planar lidar, or a driver that needs an occupancy map.
    """
    # Who maps a log does not load the simulator.
    from lirs_envs.lidar.presets import RING_LIDARS, make_lidar_preset
    from lirs_envs.robots.catalog import make_robot

    if not reads_clouds(mapper):
        return
    lidar = make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    if lidar.rings == 1:
        raise ConfigError(
            f"mapper {config.mapper} needs a lidar with rings, got {lidar.name}; "
            f"legal: --lidar {' or '.join(RING_LIDARS)}"
        )
    if driver_parts(config.driver)[0] == "frontier":
        raise ConfigError(
            f"driver frontier plans on the mapper's occupancy map, and {config.mapper} has none; "
            f"legal: {', '.join(name for name in DRIVERS if name != 'frontier')}"
        )


def occupancy_map(mapper: GuardedMapper | GuardedCloudMapper) -> Callable[[], OccupancyGrid]:
    """Return the function for the mapper's current occupancy map.

    It raises ConfigError for a mapper of point clouds.
    """
    return mapper.map if isinstance(mapper, GuardedMapper) else _no_map


def _no_map() -> OccupancyGrid:
    raise ConfigError("a mapper of point clouds has no occupancy map")


def cloud_copy(cloud: PointCloud) -> PointCloud:
    """Return a read-only copy of a cloud, with a copy of its mount."""
    xyz, ring, time = cloud.xyz.copy(), cloud.ring.copy(), cloud.time.copy()
    for array in (xyz, ring, time):
        array.flags.writeable = False
    return PointCloud(xyz, ring, time, cloud.stamp, replace(cloud.T_base_laser))


def check_pose3(estimate: object, stamp: float) -> None:
    """Check that an answer is a finite pose in space.

    Raises:
        MapperError: it is not; the message names the scan's stamp.
    """
    if not isinstance(estimate, Pose3):
        raise MapperError(
            f"update() must return a Pose3, got {kind_of(estimate)} for the scan at {stamp:.3f} s"
        )
    if not all(math.isfinite(value) for value in astuple(estimate)):
        raise MapperError(f"update() must return a finite pose, got {estimate} for the scan at {stamp:.3f} s")
