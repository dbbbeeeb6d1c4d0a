"""Online loop of driver, simulation and mapper, one lidar period per tick."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

from lirs_envs.sensing.sensors import Observation
from lirs_envs.simulation import Simulation
from lirs_validation.driving.driver import Driver
from lirs_validation.experiment.drive_log import DriveLog
from lirs_validation.experiment.mapper_under_test import Estimate, MapperUnderTest
from lirs_validation.record.run_record import Status
from lirs_validation.record.verdict import LostRule
from lirs_wct import Pose2, Pose3, SimulationError
from lirs_wct.progress import Progress, no_progress

Recorder = Callable[[Observation, Pose3, Pose2], None]
"""Receives the observation with its cloud, the true pose `T_world_base` and the mapper's answer
`T_map_base`, in the plane."""


class Drive:
    """Drive in single ticks, until time is over, a failure, or the driver ends.

    Attributes:
        log: log so far, with the status at the drive's end.
        over: whether it has ended.

    Args:
        simulation: simulation, which is reset to the driver's start.
        mapper: mapper, which is closed by who made it.
        wall_limit: wall seconds after which the drive is stopped; None = never.
        recorder: is shown every scan once it is mapped; its time counts.

    Raises:
        MapperError: the mapper failed.
    """

    def __init__(
        self,
        simulation: Simulation,
        driver: Driver,
        mapper: MapperUnderTest,
        seconds: float,
        *,
        wall_limit: float | None = None,
        recorder: Recorder | None = None,
    ) -> None:
        self._simulation, self._driver, self._mapper = simulation, driver, mapper
        self._seconds, self._wall_limit, self._recorder = seconds, wall_limit, recorder
        self._ticks = max(1, math.ceil(seconds / simulation.period - 1e-9))
        self._tracking = LostRule()
        self._spent = 0.0
        self.log, self.over = DriveLog(driver.start, mapper.reads_clouds), False
        # The first scan comes before anything moves: no simulated time passes.
        self._map(simulation.reset(driver.start))

    def __iter__(self) -> Iterator[float]:
        """Simulate, sense, map and record tick by tick; yield the simulated time.

        Raises:
            MapperError: the mapper failed.
        """
        log = self.log
        try:
            while not self.over:
                begun = time.perf_counter()
                observation = self._advance()
                # Before the mapper: a client that ends the drive while it maps ends it with the next scan.
                finished = self._driver.finished
                estimate = self._map(observation)
                log.mapper_seconds.append(estimate.seconds)
                log.walls.append(time.perf_counter() - begun)
                self._judge(observation.scan.stamp, estimate, finished)
                yield self.time
        except SimulationError as error:
            self._end("diverged", str(error))

    @property
    def time(self) -> float:
        """Simulated seconds since the start, as far as the log goes."""
        return len(self.log.walls) * self._simulation.period

    def _advance(self) -> Observation:
        """Drive the simulation by a tick; return its observation.

        Raises:
            SimulationError: the simulation diverged.
        """
        log, simulation, driver = self.log, self._simulation, self._driver
        pose = planar(simulation.T_world_base if driver.frame == "world" else log.estimates[-1])
        command = driver.command(pose, len(log.commands) * simulation.period)
        log.commands.append(command)
        return simulation.advance(command)

    def _map(self, observation: Observation) -> Estimate:
        """Map an observation and log it with the truth; return the mapper's estimate."""
        log, simulation = self.log, self._simulation
        self._driver.sense(observation.scan, observation.odometry)
        estimate = self._mapper.observe(observation)
        T_world_base = simulation.T_world_base
        points = simulation.walker_points if log.spatial else None
        log.add(observation, T_world_base, estimate.pose, simulation.walker_beams, points)
        if self._recorder is not None:
            self._recorder(observation, T_world_base, log.in_plane(estimate.pose))
        return estimate

    def _judge(self, stamp: float, estimate: Estimate, finished: str) -> None:
        """End the drive if a tick requires it."""
        self._tracking.observe(stamp, estimate.lost)
        self._spent += self.log.walls[-1]
        before_its_time, now = self.time < self._seconds, self._simulation.time
        failure = _failure(self._simulation, self._driver)
        if failure is not None:
            self._end(*failure)
        elif self._tracking.too_long is not None:
            self._end("lost", self._tracking.too_long)
        elif finished and before_its_time:
            self._finish("ok", f"{finished} at {now:.1f} s")
        elif self._wall_limit is not None and self._spent >= self._wall_limit and before_its_time:
            self._finish("wall limit", _over(self._spent, now, self._seconds))
        elif len(self.log.walls) >= self._ticks:
            self._finish(self.log.status, self.log.reason)

    def _finish(self, status: Status, reason: str) -> None:
        lost = self._tracking.reason()
        self._end(*(status, reason) if lost is None else ("lost", lost))

    def _end(self, status: Status, reason: str) -> None:
        self.log.status, self.log.reason, self.over = status, reason, True


def drive(
    simulation: Simulation,
    driver: Driver,
    mapper: MapperUnderTest,
    seconds: float,
    progress: Progress = no_progress,
    *,
    wall_limit: float | None = None,
    recorder: Recorder | None = None,
) -> DriveLog:
    """Drive until the time is over, or a failure or the wall limit (see `Drive`)."""
    taken = Drive(simulation, driver, mapper, seconds, wall_limit=wall_limit, recorder=recorder)
    next_report = 1.0
    for driven in taken:
        if driven >= next_report:
            progress("drive", driven / seconds)
            next_report += 1.0
    return taken.log


def planar(pose: Pose2 | Pose3) -> Pose2:
    """Return a pose projected on the plane."""
    return pose.to_pose2() if isinstance(pose, Pose3) else pose


def _failure(simulation: Simulation, driver: Driver) -> tuple[Status, str] | None:
    if simulation.tipped:
        return "tipped", f"the robot tipped over at {simulation.time:.1f} s"
    if simulation.off_world:
        return "off world", f"the robot left the world at {simulation.time:.1f} s"
    if driver.stuck:
        return "stuck", f"the robot made no progress and gave up at {simulation.time:.1f} s"
    return None


def _over(spent: float, driven: float, seconds: float) -> str:
    return (
        f"stopped at the wall limit, after {spent:.1f} s for {driven:.1f} of {seconds:g} simulated seconds; "
        "its real-time factor is extrapolated from these"
    )
