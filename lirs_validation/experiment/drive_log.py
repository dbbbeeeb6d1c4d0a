"""Log of a drive: observations, true poses and the mapper's answers."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Generic, TypeVar

import numpy as np

from lirs_envs.robots.robot import Twist
from lirs_envs.sensing.sensors import Observation
from lirs_validation.metrics.elevation import CloudSample
from lirs_validation.record.run_record import Status
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry import Imu, LaserScan, Pose2, Pose3, Trajectory
from slam_baselines.dead_reckoning import spatial_odometry

T = TypeVar("T")


class PackedList(Generic[T]):
    """Append-only sequence that stores its values as numbers of one array.

    Args:
        pack: returns the numbers of a value, always as many.
        unpack: makes the value of these numbers.
    """

    def __init__(self, pack: Callable[[T], tuple[float, ...]], unpack: Callable[..., T]) -> None:
        self._pack, self._unpack = pack, unpack
        self._numbers, self._width = array("d"), 1

    def append(self, value: T) -> None:
        """Add a value at the end."""
        numbers = self._pack(value)
        self._numbers.extend(numbers)
        self._width = len(numbers)

    def __len__(self) -> int:
        return len(self._numbers) // self._width

    def __getitem__(self, index: int) -> T:
        first = range(len(self))[index] * self._width
        return self._unpack(*self._numbers[first : first + self._width])

    def __iter__(self) -> Iterator[T]:
        return (self[index] for index in range(len(self)))


_numbers3: Callable[[Pose3], tuple[float, ...]] = attrgetter("x", "y", "z", "qw", "qx", "qy", "qz")


@dataclass
class DriveLog:
    """Log of a drive.

    Each scan adds one entry; an hour's drive takes about 300 megabytes.

    Attributes:
        start: start pose of the driver, world frame.
        spatial: whether the mapper estimates poses in space.
        scans: Scans alone, without their clouds.
        odometry: `T_odom_base` of each scan.
        imu: Inertial reading of each scan.
        clouds: some of these, of a mapper that reads them.
        walker_beams: which beams of each scan met a walker; empty where there are none.
        truth: `T_world_base`, from the simulator.
        estimates: `T_map_base`, the mapper's online answers, in the plane or in space.
        final: the mapper's trajectory in the map frame after the drive; None while it lasts.
        walls: wall-clock seconds of each tick.
        mapper_seconds: seconds of the mapper's updates.
        status: at the drive's end; `reason` explains it.
        concurrent: whether other runs shared the processor.
        load: system's load average at the drive's end; None without a count.
        commands: commands of the driver, one per tick: after the first observation, the second, ...
    """

    start: Pose2 = field(default_factory=Pose2)
    spatial: bool = False
    scans: list[LaserScan] = field(default_factory=list)
    odometry: PackedList[Pose2] = field(
        default_factory=lambda: PackedList(attrgetter("x", "y", "yaw"), Pose2)
    )
    imu: PackedList[Imu] = field(default_factory=lambda: PackedList(attrgetter("row"), Imu.from_row))
    clouds: CloudSample = field(default_factory=CloudSample)
    walker_beams: list[BoolArray] = field(default_factory=list)
    truth: PackedList[Pose3] = field(default_factory=lambda: PackedList(_numbers3, Pose3))
    estimates: list[Pose2 | Pose3] = field(default_factory=list)
    commands: PackedList[Twist] = field(
        default_factory=lambda: PackedList(attrgetter("v", "omega", "climb"), Twist)
    )
    final: Trajectory | None = None
    walls: list[float] = field(default_factory=list)
    mapper_seconds: list[float] = field(default_factory=list)
    status: Status = "ok"
    reason: str = ""
    concurrent: bool = False
    load: float | None = None

    def add(
        self,
        observation: Observation,
        T_world_base: Pose3,
        estimate: Pose2 | Pose3,
        walker_beams: BoolArray | None = None,
        walker_points: BoolArray | None = None,
    ) -> None:
        """Append an observation and its true pose, and the mapper's estimate.

        The masks tell the scan's beams and the cloud's points that met a walker; None without walkers.
        """
        scan = observation.scan
        if observation.cloud is not None:
            if self.spatial:
                self.clouds.offer(len(self.scans), observation.cloud, walker_points)
            scan = replace(scan, ranges=scan.ranges.copy())  # not the whole sweep
        self.scans.append(scan)
        self.odometry.append(observation.odometry)
        self.imu.append(observation.imu)
        if walker_beams is not None:
            self.walker_beams.append(walker_beams)
        self.truth.append(T_world_base)
        self.estimates.append(estimate)

    @property
    def observations(self) -> list[Observation]:
        """The mapper's inputs, without clouds and inertial readings."""
        return list(map(Observation, self.scans, self.odometry, self.imu))

    @property
    def stamps(self) -> FloatArray:
        """(n,) stamps of the scans, seconds."""
        return np.array([scan.stamp for scan in self.scans])

    @property
    def T_world_map(self) -> Pose2 | Pose3:  # noqa: N802  a frame pair
        """True start pose, in space or in the plane, like the mapper's map frame."""
        return self.truth[0] if self.spatial else self.truth[0].to_pose2()

    def in_plane(self, T_map_base: Pose2 | Pose3) -> Pose2:
        """Return an estimate projected on the plane.

        It is in the level map frame at the true start pose.
        """
        if isinstance(T_map_base, Pose2):
            return T_map_base
        T_level_world = Pose3.from_pose2(self.truth[0].to_pose2().inverse())
        return (T_level_world @ self.truth[0] @ T_map_base).to_pose2()

    def online(self) -> Trajectory:
        """Return the mapper's online estimates in the map frame."""
        return Trajectory.from_poses(self.stamps, self.estimates)

    def spatial_odometry(self) -> Trajectory:
        """Return dead reckoning in space by wheels, gyro and gravity, world frame."""
        poses = spatial_odometry(list(self.odometry), list(self.imu))
        return Trajectory.from_poses(self.stamps, poses).moved(self.truth[0] @ poses[0].inverse())

    def scans_dropped(self, received: int) -> int:
        """Return the number of scans that the mapper dropped.

        A mapper with a queue may drop scans; `received` 0 means that it does not count them.
        """
        return max(0, len(self.scans) - received) if received else 0

    def trajectories(self) -> tuple[Trajectory, Trajectory, Trajectory]:
        """Return truth, final estimate and odometry, all in the world frame.

        The final estimate is the mapper's own, with all that it learnt later; see `online`.
        """
        stamps, T_odom_base = self.stamps, self.odometry[0]
        T_world_odom = self.truth[0].to_pose2() @ T_odom_base.inverse()
        return (
            Trajectory.from_poses(stamps, self.truth),
            (self.online() if self.final is None else self.final).moved(self.T_world_map),
            Trajectory.from_poses(stamps, self.odometry).moved(T_world_odom),
        )
