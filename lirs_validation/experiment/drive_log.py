"""Log of a drive: observations, true poses and the mapper's answers."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import overload

import numpy as np

from lirs_envs.robots.command import Twist
from lirs_envs.sensing.sensors import Observation
from lirs_validation.experiment.cloud_elevation import CloudSample
from lirs_validation.experiment.feeding.feeding import Place
from lirs_validation.record.run_record import Status
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.rows import Rows
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from lirs_wct.spool import ArraySpool


@dataclass(frozen=True, slots=True)
class Tick:
    """State of a simulation after a tick.

    The simulation may go on before the mapper has answered.

    Attributes:
        observation: of the sensors.
        T_world_base: true pose.
        time: simulated seconds since the start.
        walker_beams: which beams of the scan met a walker; None where there are none.
        walker_points: the same of the points of the cloud.
        failure: how the drive ends here, and why; None where it goes on.
        finished: why nothing is left to drive; empty while there is.
    """

    observation: Observation
    T_world_base: Pose3
    time: float
    walker_beams: BoolArray | None = None
    walker_points: BoolArray | None = None
    failure: tuple[Status, str] | None = None
    finished: str = ""


@dataclass
class DriveLog:
    """Log of a drive.

    It grows by one entry per scan, about 250 bytes in memory.

    Attributes:
        observations: the mapper's inputs, without the clouds.
        clouds: some of these, of a mapper that reads them.
        walker_beams: which beams of each scan met a walker; empty where there are none.
        truth: `T_world_base`, from the simulator.
        estimates: `T_map_base`, the mapper's online answers, in the plane or in space.
        final: the mapper's trajectory in the map frame after the drive; None while it lasts.
        walls: wall-clock seconds of each tick.
        mapper_seconds: seconds of the mapper's updates, within the ticks or parallel to them.
        waiting: seconds of each tick in which the drive waited for the mapper.
        status: at the drive's end; `reason` explains it.
        concurrent: whether something else of ours ran at the same time.
        start: where the driver had the robot set down, world frame.
        commands: of the driver, one per tick: the commands after the first observation, the second, ...
        spatial: whether the mapper estimates poses in space.
        mapper_in: where it worked.
    """

    observations: ObservationLog
    walker_beams: ArraySpool[np.bool]
    estimates: Rows[Pose2] | Rows[Pose3]
    clouds: CloudSample = field(default_factory=CloudSample)
    truth: Rows[Pose3] = field(default_factory=lambda: Rows.of(Pose3))
    final: Trajectory | None = None
    walls: array[float] = field(default_factory=lambda: array("d"))
    mapper_seconds: array[float] = field(default_factory=lambda: array("d"))
    waiting: array[float] = field(default_factory=lambda: array("d"))
    status: Status = "ok"
    reason: str = ""
    concurrent: bool = False
    start: Pose2 = field(default_factory=Pose2)
    commands: Rows[Twist] = field(default_factory=lambda: Rows.of(Twist))
    spatial: bool = False
    mapper_in: Place = "drive"

    @staticmethod
    def begin(start: Pose2, *, spatial: bool = False, folder: Path | None = None) -> DriveLog:
        """Return the log of a drive before its first scan.

        Args:
            start: where the driver has the robot set down, world frame.
            spatial: whether the mapper estimates poses in space.
            folder: of the files that hold what memory should not; they have no names, and are gone with the
                process. None = the system's folder for temporary files.
        """
        estimates = Rows.of(Pose3) if spatial else Rows.of(Pose2)
        return DriveLog(ObservationLog(folder), ArraySpool(folder), estimates, start=start, spatial=spatial)

    def add(self, tick: Tick, estimate: Pose2 | Pose3) -> None:
        """Append a tick's observation and true pose, and the mapper's estimate."""
        observation = tick.observation
        if observation.cloud is not None and self.spatial:
            self.clouds.offer(len(self.observations), observation.cloud, tick.walker_points)
        self.observations.append(observation)
        if tick.walker_beams is not None:
            self.walker_beams.append(tick.walker_beams)
        self.truth.append(tick.T_world_base)
        self.estimates.append(estimate)  # type: ignore[arg-type]  # of the mapper's kind

    def forget_times(self) -> None:
        """Discard the times of the ticks so far."""
        del self.walls[:], self.mapper_seconds[:], self.waiting[:]

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
        return Trajectory.from_poses(self.observations.stamps, self.estimates)

    def scans_dropped(self, received: int) -> int:
        """Return the number of scans that the mapper dropped.

        A mapper with a queue may drop scans; `received` 0 means that it does not count them.
        """
        return max(0, len(self.observations) - received) if received else 0

    def trajectories(self) -> tuple[Trajectory, Trajectory, Trajectory]:
        """Return truth, final estimate and odometry, all in the world frame.

        The final estimate is the mapper's own, with all that it learnt later; see `online`.
        """
        T_odom_base = self.observations[0].odometry
        T_world_odom = self.truth[0].to_pose2() @ T_odom_base.inverse()
        return (
            Trajectory.from_poses(self.observations.stamps, self.truth),
            (self.online() if self.final is None else self.final).moved(self.T_world_map),
            Trajectory.from_poses(self.observations.stamps, self.observations.odometry).moved(T_world_odom),
        )


LIDAR = attrgetter("angle_min", "angle_increment", "range_min", "range_max", "time_increment", "T_base_laser")
"""Fields that all scans of a lidar share."""


class ObservationLog(Sequence[Observation]):
    """Growing sequence of observations without clouds.

    All come from one robot; items are copies.

    Attributes:
        odometry: of the observations.
        imu: of the observations.

    Args:
        folder: of the file of ranges; None = the system's folder for temporary files.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._first: LaserScan | None = None
        self._lidar: tuple[object, ...] = ()
        self._ranges = ArraySpool[np.float32](folder)
        self._stamps = array("d")
        self.odometry = Rows.of(Pose2)
        self.imu = Rows(Imu.from_row, attrgetter("row"), 9)

    def append(self, observation: Observation) -> None:
        """Add an observation of the same lidar.

        Raises:
            ValueError: the lidar is another one.
            OutputError: the file of ranges cannot be written.
        """
        scan = observation.scan
        if self._first is None:
            self._first, self._lidar = replace(scan, ranges=scan.ranges[:0]), LIDAR(scan)
        if LIDAR(scan) != self._lidar:
            raise ValueError(f"a drive has one lidar: {self._lidar}, got {LIDAR(scan)}")
        self._ranges.append(scan.ranges)
        self._stamps.append(scan.stamp)
        self.odometry.append(observation.odometry)
        self.imu.append(observation.imu)

    @property
    def stamps(self) -> FloatArray:
        """(n,) stamps of the scans, seconds."""
        return np.array(self._stamps)

    def __len__(self) -> int:
        return len(self._stamps)

    @overload
    def __getitem__(self, index: int) -> Observation: ...
    @overload
    def __getitem__(self, index: slice) -> list[Observation]: ...
    def __getitem__(self, index: int | slice) -> Observation | list[Observation]:
        if isinstance(index, slice):
            return [self[k] for k in range(len(self))[index]]
        scan = self._scan(self._ranges[index], self._stamps[index])
        return Observation(scan, self.odometry[index], self.imu[index])

    def __iter__(self) -> Iterator[Observation]:
        columns = self._ranges, self._stamps, self.odometry, self.imu
        for ranges, stamp, odometry, imu in zip(*columns, strict=True):
            yield Observation(self._scan(ranges, stamp), odometry, imu)

    def _scan(self, ranges: Float32Array, stamp: float) -> LaserScan:
        assert self._first is not None
        return replace(self._first, ranges=ranges, stamp=stamp)
