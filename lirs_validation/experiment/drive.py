"""Online loop of driver, simulation and mapper, and its log."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Generic, Protocol, TypeVar

import numpy as np

from lirs_envs.robots.robot import Twist
from lirs_envs.sensing.sensors import Observation
from lirs_envs.simulation import Simulation
from lirs_validation.driving.path_driver import Frame
from lirs_validation.experiment.mapper_under_test import Estimate, LostRule, MapperUnderTest
from lirs_validation.metrics.elevation import CloudSample
from lirs_validation.record.run_record import Status
from lirs_wct import BoolArray, FloatArray, Imu, LaserScan, Pose2, Pose3, SimulationError, Trajectory
from slam_baselines.dead_reckoning import spatial_odometry
from slam_baselines.watch import Watch


class Driver(Protocol):
    """Anything that drives a robot, one command a scan."""

    @property
    def start(self) -> Pose2:
        """Start pose of the robot, world frame."""

    @property
    def frame(self) -> Frame:
        """Frame of the poses that `command` receives."""

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up."""

    @property
    def finished(self) -> str:
        """Reason why nothing is left to drive; empty while there is."""

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return the command for the next tick.

        The pose is in the driver's frame, the time in seconds since the robot began to drive.
        """


Recorder = Callable[[Observation, Pose3, Pose2], None]
"""Receives the observation with its cloud, the true pose `T_world_base` and the mapper's answer
`T_map_base`, in the plane."""


def drive(
    simulation: Simulation,
    driver: Driver,
    mapper: MapperUnderTest,
    log: DriveLog,
    seconds: float,
    *,
    stand: float = 0.0,
    wall_limit: float | None = None,
    recorder: Recorder | None = None,
) -> Iterator[float]:
    """Simulate, map and log scan by scan; yield the simulated time of each.

    The drive ends with its time, standing included, at the wall limit (wall seconds), with a failure or with
    the driver; the log says why. The recorder receives each mapped scan.
    """
    period, tracking, spent = simulation.period, LostRule(), 0.0
    ticks, limit = max(1, math.ceil(seconds / period - 1e-9)), wall_limit or math.inf
    # The first scan comes before anything moves: no simulated time passes.
    observation = simulation.reset(driver.start)
    T_world_base, estimate = simulation.pose(), mapper.observe(observation)
    _add(log, observation, simulation, T_world_base, estimate, recorder)
    yield 0.0
    for tick in range(1, ticks + 1):
        begun, time_driven, command = time.perf_counter(), (tick - 1) * period - stand, Twist()
        if time_driven > -5e-7:  # half a microsecond: sums of periods are not exact
            pose = T_world_base.to_pose2() if driver.frame == "world" else planar(estimate.pose)
            command = driver.command(pose, time_driven, observation.scan, observation.odometry)
        try:
            observation = simulation.advance(command)
        except SimulationError as error:
            log.commands.append(command)
            log.end("diverged", str(error))
            return
        T_world_base, mishap = simulation.pose(), simulation.mishap
        # Before the mapper: a client that ends the drive while it maps ends it with the next scan.
        finished = driver.finished
        estimate = mapper.observe(observation)
        tracking.observe(observation.scan.stamp, estimate.lost)
        log.commands.append(command)
        _add(log, observation, simulation, T_world_base, estimate, recorder)
        log.mapper_seconds.append(estimate.seconds)
        log.tick_seconds.append(time.perf_counter() - begun)
        spent += log.tick_seconds[-1]
        now = tick * period
        if mishap:
            what = "tipped over" if mishap == "tipped" else "left the world"
            log.end(mishap, f"the robot {what} at {now:.1f} s")
        elif driver.stuck:
            log.end("stuck", f"the robot made no progress and gave up at {now:.1f} s")
        elif estimate.lost and tracking.too_long is not None:
            log.end("lost", tracking.too_long)
        elif tick == ticks or finished or spent >= limit:
            log.end(*_result(tracking, finished, now, seconds, spent, limit))
        yield now
        if log.over:
            return


def _add(
    log: DriveLog,
    observation: Observation,
    simulation: Simulation,
    T_world_base: Pose3,
    estimate: Estimate,
    recorder: Recorder | None,
) -> None:
    """Log a mapped observation with the truth, and hand it to the recorder."""
    masks = (simulation.walker_beams, simulation.walker_points) if simulation.config.actors else (None, None)
    log.add(
        observation, T_world_base, estimate.pose, *masks, covariance=estimate.covariance, lost=estimate.lost
    )
    if recorder is not None:
        recorder(observation, T_world_base, log.in_plane(estimate.pose))


def planar(pose: Pose2 | Pose3) -> Pose2:
    """Return a pose projected on the plane."""
    return pose.to_pose2() if isinstance(pose, Pose3) else pose


def _result(
    tracking: LostRule, finished: str, now: float, seconds: float, spent: float, limit: float
) -> tuple[Status, str]:
    """Return status and reason of a drive that ends without a failure of the robot."""
    lost = tracking.reason()
    if lost is not None:
        return "lost", lost
    if finished and now < seconds:
        return "ok", f"{finished} at {now:.1f} s"
    if spent >= limit and now < seconds:
        return "wall limit", (
            f"stopped at the wall limit, after {spent:.1f} s for {now:.1f} of {seconds:g} simulated seconds; "
            "its real-time factor is extrapolated from these"
        )
    return "ok", ""


T = TypeVar("T")


class PackedList(Generic[T]):
    """Append-only sequence that stores its values as numbers of one array.

    `pack` returns the numbers of a value, always as many; `unpack` makes the value of them.
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


def _pack_as(kind: Callable[..., T], *names: str) -> Callable[[], PackedList[T]]:
    return lambda: PackedList(attrgetter(*names), kind)


@dataclass
class DriveLog:
    """Log of a drive.

    Each scan adds one entry; an hour's drive takes about 300 megabytes.

    Attributes:
        start: Start pose of the driver, world frame.
        spatial: Whether the mapper estimates poses in space.
        scans: Scans alone, without their clouds.
        odometry: `T_odom_base` of each scan.
        clouds: Sample of the clouds, of a mapper that reads them.
        walker_beams: Masks of each scan's beams that met a walker; empty without walkers.
        truth: `T_world_base`, from the simulator.
        estimates: `T_map_base`, the mapper's online answers, in the plane or in space.
        lost: Whether the mapper did not know its place, scan by scan.
        alarms: Whether the watch on its poses gave an alarm, scan by scan.
        covariances: (3, 3) each of x, y, yaw of the estimates; None where the mapper gave none.
        commands: Commands of the driver, one per tick: after the first observation, the second, ...
        final_trajectory: Trajectory of the mapper in its map frame after the drive; None while it lasts.
        tick_seconds: Wall-clock seconds of each tick.
        mapper_seconds: Wall-clock seconds of the mapper's updates.
        status: Status at the drive's end; `reason` explains it.
        concurrent: Whether other runs shared the processor.
        load: Load average of the system at the drive's end; None without a count.
    """

    start: Pose2 = field(default_factory=Pose2)
    spatial: bool = False
    scans: list[LaserScan] = field(default_factory=list)
    odometry: PackedList[Pose2] = field(default_factory=_pack_as(Pose2, "x", "y", "yaw"))
    imu: list[Imu] = field(default_factory=list)
    clouds: CloudSample = field(default_factory=CloudSample)
    walker_beams: list[BoolArray] = field(default_factory=list)
    truth: PackedList[Pose3] = field(default_factory=_pack_as(Pose3, "x", "y", "z", "qw", "qx", "qy", "qz"))
    estimates: list[Pose2 | Pose3] = field(default_factory=list)
    lost: list[bool] = field(default_factory=list)
    alarms: list[bool] = field(default_factory=list)
    covariances: list[FloatArray | None] = field(default_factory=list)
    commands: PackedList[Twist] = field(default_factory=_pack_as(Twist, "v", "omega", "climb"))
    final_trajectory: Trajectory | None = None
    tick_seconds: list[float] = field(default_factory=list)
    mapper_seconds: list[float] = field(default_factory=list)
    status: Status = "ok"
    reason: str = ""
    over: bool = False
    concurrent: bool = False
    load: float | None = None
    watch: Watch = field(default_factory=Watch)

    def add(
        self,
        observation: Observation,
        T_world_base: Pose3,
        estimate: Pose2 | Pose3,
        walker_beams: BoolArray | None = None,
        walker_points: BoolArray | None = None,
        covariance: FloatArray | None = None,
        *,
        lost: bool = False,
    ) -> None:
        """Append an observation and its true pose, and the mapper's estimate.

        The masks tell the scan's beams and the cloud's points that met a walker; None without walkers.
        """
        scan = observation.scan
        if observation.cloud is not None:
            if self.spatial:
                self.clouds.offer(len(self.scans), observation.cloud, walker_points)
            scan = replace(scan, ranges=scan.ranges.copy())  # not the whole revolution
        self.scans.append(scan)
        self.odometry.append(observation.odometry)
        self.imu.append(observation.imu)
        if walker_beams is not None:
            self.walker_beams.append(walker_beams)
        self.truth.append(T_world_base)
        self.estimates.append(estimate)
        self.covariances.append(covariance)
        self.lost.append(lost)
        self.alarms.append(self.watch.update(self.in_plane(estimate), scan.stamp, observation.odometry))

    def end(self, status: Status, reason: str) -> None:
        """End the drive."""
        self.status, self.reason, self.over = status, reason, True

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
        """Return an estimate projected on the plane, in the level map frame."""
        if isinstance(T_map_base, Pose2):
            return T_map_base
        T_level_world = Pose3.from_pose2(self.truth[0].to_pose2().inverse())
        return (T_level_world @ self.truth[0] @ T_map_base).to_pose2()

    def online(self) -> Trajectory:
        """Return the mapper's online estimates in the map frame."""
        return Trajectory.from_poses(self.stamps, self.estimates)

    def spatial_odometry(self) -> Trajectory:
        """Return dead reckoning in space by wheels, gyro and gravity, world frame."""
        poses = spatial_odometry(list(self.odometry), self.imu)
        return Trajectory.from_poses(self.stamps, poses).moved(self.truth[0] @ poses[0].inverse())

    def trajectories(self) -> tuple[Trajectory, Trajectory, Trajectory]:
        """Return truth, final estimate and odometry, all in the world frame.

        The final estimate is the mapper's own, with all that it learnt later; see `online`.
        """
        T_world_odom = self.truth[0].to_pose2() @ self.odometry[0].inverse()
        estimate = self.online() if self.final_trajectory is None else self.final_trajectory
        return (
            Trajectory.from_poses(self.stamps, self.truth),
            estimate.moved(self.T_world_map),
            Trajectory.from_poses(self.stamps, self.odometry).moved(T_world_odom),
        )
