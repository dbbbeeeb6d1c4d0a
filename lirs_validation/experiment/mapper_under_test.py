"""Mapper of a run or a log, isolated: read-only inputs, exceptions become MapperError."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import FrozenInstanceError, dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import numpy as np

from lirs_validation.config import DRIVERS, Attitude, RunConfig, driver_parts
from lirs_validation.experiment.cost import Cost
from lirs_validation.processes import is_interrupt
from lirs_wct import (
    ConfigError,
    Imu,
    ImuReadings,
    LaserScan,
    MapperError,
    OccupancyGrid,
    PointCloud,
    Pose2,
    Pose3,
    Trajectory,
    WctError,
)
from slam_baselines.mapper import (
    CloudMapper,
    Mapper,
    MapperStats,
    reads_clouds,
    reads_inertial,
    reads_odometry,
    requires_odometry,
)

if TYPE_CHECKING:  # mapping a log does not load the simulator
    from lirs_envs.sensing.sensors import Observation

READ_ONLY = re.compile(r"read-?only", re.IGNORECASE)
"""Matches messages of NumPy and Numba about a write into a read-only array."""
METHODS = ("map", "trajectory")
"""Parts of a mapper that are methods; `stats` and `lost` are properties."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class SensorReadings:
    """Sensor readings at one stamp of a log.

    Attributes:
        scan: planar scan; None for a mapper of point clouds.
        odometry: `T_odom_base`; None without odometry.
        imu: inertial reading; None without one.
        cloud: point cloud; None for a planar mapper.
        inertial: readings near 200 Hz since the last stamp; None for a mapper that does not take them.
    """

    scan: LaserScan | None = None
    odometry: Pose2 | None = None
    imu: Imu | None = None
    cloud: PointCloud | None = None
    inertial: ImuReadings | None = None


@dataclass(frozen=True, slots=True)
class Estimate:
    """Answer of a mapper to an observation.

    Attributes:
        pose: `T_map_base`, in the plane or in space.
        lost: whether the mapper does not know its place.
        seconds: wall-clock time of its update.
    """

    pose: Pose2 | Pose3
    lost: bool
    seconds: float


class MapperUnderTest:
    """A planar or cloud mapper in this process.

    Its inputs are copies, so that a mapper that makes them writable again changes nothing else. Its answers
    are checked, and its failures become `MapperError`. Without attitude, the mapper gets no inertial reading:
    a reading without roll and pitch would still hold the direction of gravity.

    Attributes:
        name: name in messages.
        reads_clouds: whether it reads point clouds.
        requires_odometry: whether it needs odometry.
        reads_inertial: whether it takes all inertial readings.
        reads_odometry: whether it takes the odometry, if it reads point clouds.
        in_process: whether it has a process of its own.

    Args:
        make: function that creates the mapper.
        attitude: `imu`, or `none` for a mapper without inertial readings.
    """

    in_process = False

    def __init__(
        self, make: Callable[[], Mapper | CloudMapper], name: str, attitude: Attitude = "imu"
    ) -> None:
        self.name, self._make, self._attitude = name, make, attitude
        self._mapper: Any = make()
        self.reads_clouds = reads_clouds(self._mapper)
        self.requires_odometry = requires_odometry(self._mapper)
        self.reads_inertial = reads_inertial(self._mapper)
        self.reads_odometry = reads_odometry(self._mapper)

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Give the mapper an observation; return its estimate.

        Raises:
            ConfigError: it reads point clouds or all inertial readings, and there are none.
            MapperError: it fails, writes into its inputs, or returns no finite pose of its kind.
        """
        begun = time.perf_counter()
        sensed = observation.cloud if self.reads_clouds else observation.scan
        if sensed is None:
            raise ConfigError("a mapper of point clouds needs a lidar with rings")
        if self.reads_inertial and observation.inertial is None:
            raise ConfigError(f"mapper {self.name!r} needs inertial readings near 200 Hz: there are none")
        imu = imu_copy(observation.imu) if self._attitude == "imu" else None
        try:
            if isinstance(sensed, PointCloud):
                further: list[Any] = [deepcopy(observation.inertial)] if self.reads_inertial else []
                further += [pose_copy(observation.odometry)] if self.reads_odometry else []
                pose = self._mapper.update(cloud_copy(sensed), imu, *further)
            else:
                pose = self._mapper.update(scan_copy(sensed), pose_copy(observation.odometry), imu)
        except BaseException as error:
            mapper_failure(self.name, "update()", error, f" for the scan at {sensed.stamp:.3f} s")
        check_pose(pose, Pose3 if self.reads_clouds else Pose2, sensed.stamp)
        seconds = time.perf_counter() - begun
        return Estimate(pose, self.lost, seconds)

    def map(self) -> OccupancyGrid:
        """Return the mapper's map.

        Raises:
            ConfigError: it is a mapper of point clouds.
            MapperError: it fails, or returns no occupancy grid.
        """
        if self.reads_clouds:
            raise ConfigError("a mapper of point clouds has no occupancy map")
        return _require_kind(self._ask("map"), OccupancyGrid, "map() must return an OccupancyGrid")

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory.

        Raises:
            MapperError: it fails, or returns no finite trajectory.
        """
        found = _require_kind(self._ask("trajectory"), Trajectory, "trajectory() must return a Trajectory")
        wrong = ~(np.isfinite(found.positions).all(axis=1) & np.isfinite(found.quaternions).all(axis=1))
        if wrong.any():
            raise MapperError(f"trajectory() is not finite at {found.stamps[wrong.argmax()]:.3f} s")
        return found

    @property
    def stats(self) -> MapperStats:
        """Statistics of the mapper."""
        return _require_kind(self._ask("stats"), MapperStats, "stats must be a MapperStats")

    @property
    def lost(self) -> bool:
        """Whether the mapper does not know its place."""
        return bool(self._ask("lost"))

    def restart(self) -> None:
        """Make a new mapper."""
        self._mapper = self._make()

    def cost(self) -> Cost:
        """Return the mapper's cost in addition to this process's, since `restart`."""
        return Cost(0.0, 0)

    def close(self) -> None:
        """Release the mapper's resources."""

    def _ask(self, part: str) -> Any:
        """Return the result of a method or the value of a property of the mapper."""
        try:
            value = getattr(self._mapper, part)
            return value() if part in METHODS else value
        except BaseException as error:
            mapper_failure(self.name, f"{part}()" if part in METHODS else part, error)


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


def scan_copy(scan: LaserScan) -> LaserScan:
    """Return a read-only copy of a scan and its mount."""
    ranges = scan.ranges.copy()
    ranges.flags.writeable = False
    s, p = scan, scan.T_base_laser  # dataclasses.replace takes twice as long
    mount = Pose3(p.x, p.y, p.z, p.qw, p.qx, p.qy, p.qz)
    limits = s.angle_min, s.angle_increment, s.range_min, s.range_max
    return LaserScan(ranges, *limits, s.stamp, mount, s.time_increment)


def cloud_copy(cloud: PointCloud) -> PointCloud:
    """Return a read-only copy of a cloud and its mount."""
    copy = deepcopy(cloud)
    for array in (copy.xyz, copy.ring, copy.time, copy.intensity, copy.column):
        if array is not None:
            array.flags.writeable = False
    return copy


def pose_copy(pose: Pose2 | None) -> Pose2 | None:
    """Return a copy of a pose."""
    return None if pose is None else Pose2(pose.x, pose.y, pose.yaw)


def imu_copy(imu: Imu | None) -> Imu | None:
    """Return a copy of an inertial reading, whose vectors are immutable."""
    i = imu
    return i and Imu(i.roll, i.pitch, i.angular_velocity, i.linear_acceleration, i.stamp)


_VALUES = {kind: attrgetter(*kind.__match_args__) for kind in (Pose2, Pose3)}
"""Functions that return the numbers of a pose."""


def check_pose(pose: object, kind: type[Pose2 | Pose3], stamp: float) -> None:
    """Check that an answer is a finite pose of a mapper's kind.

    Raises:
        MapperError: it is not; the message names the scan's stamp.
    """
    if not isinstance(pose, kind):
        raise MapperError(
            f"update() must return a {kind.__name__}, got {type(pose).__name__} for the scan at {stamp:.3f} s"
        )
    if not all(map(math.isfinite, _VALUES[kind](pose))):
        raise MapperError(f"update() must return a finite pose, got {pose} for the scan at {stamp:.3f} s")


def _require_kind(value: object, kind: type[T], required: str) -> T:
    """Return a value of a required type.

    Raises:
        MapperError: it is of another type.
    """
    if not isinstance(value, kind):
        raise MapperError(f"{required}, got {type(value).__name__}")
    return value


def check_sensors(mapper: MapperUnderTest, config: RunConfig) -> None:
    """Check that a run's lidar and driver suit its mapper.

    Any lidar suits a planar mapper: of one with rings it gets the ring nearest the horizon.

    Raises:
        ConfigError: a mapper of point clouds has a planar lidar, or a driver that needs an occupancy map.
    """
    # Who maps a log does not load the simulator.
    from lirs_envs.lidar.presets import RING_LIDARS, make_lidar_preset
    from lirs_envs.robots.robot import make_robot

    if not mapper.reads_clouds:
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
