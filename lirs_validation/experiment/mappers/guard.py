"""A guard before a mapper: nobody's mapper changes what it is judged by, or ends more than its own run."""

from __future__ import annotations

import re
from dataclasses import FrozenInstanceError, replace
from typing import NoReturn

from lirs_validation.experiment.mappers.checks import check_pose, final_map, final_stats, final_trajectory
from lirs_validation.interrupts import is_interrupt
from lirs_wct.errors import MapperError, WctError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.mapper import CloudMapper, Mapper, MapperStats, requires_odometry

READ_ONLY = re.compile(r"read-?only", re.IGNORECASE)
"""What NumPy and Numba say of a write into an array that may not be written to."""


class MapperGuard:
    """What the guards of planar mappers and of mappers of point clouds share."""

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
        """What the mapper counted.

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
    """A mapper that is handed copies, and whose every failure becomes a `MapperError` that names it.

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
            MapperError: the mapper fails, writes into what it was given, or answers with something else.
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
    """Raise what a failure of a mapper means: a Ctrl-C and our own errors remain what they are."""
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
    """Return a copy of a scan whose ranges are read-only, with a copy of its mount."""
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
    """Return a copy of an inertial reading; its vectors are tuples, which nobody can change."""
    if imu is None:
        return None
    return Imu(imu.roll, imu.pitch, imu.angular_velocity, imu.linear_acceleration, imu.stamp)
