"""Online loop of driver, simulation and mapper, one lidar period per step."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

from lirs_envs.sensing.sensors import Observation
from lirs_envs.simulation import Simulation
from lirs_validation.driving.driver import Driver
from lirs_validation.experiment.drive_log import DriveLog, Tick
from lirs_validation.experiment.feeding.feeding import DirectFeeding, Feeding
from lirs_validation.experiment.mapper_guard import GuardedCloudMapper
from lirs_validation.metrics.verdict import LostRule
from lirs_validation.record.run_record import Status
from lirs_wct.errors import SimulationError
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.progress import Progress, no_progress
from slam_baselines.mapper import Mapper

Recorder = Callable[[Observation, Pose3, Pose2], None]
"""Receives the observation with its cloud, the true pose `T_world_base` and the mapper's answer
`T_map_base`, in the plane."""

MOST_AHEAD = 64
"""Ticks by which a simulation is driven ahead of its mapper at most."""


class Drive:
    """Drive in single ticks, until time is over, a failure, or the driver ends.

    If the mapper works in parallel, the simulation is driven ahead of the log. It is not where a tick may be
    the last, or where the driver waits for the mapper's pose: so the log, and the counts of the simulation,
    are the same as where the mapper is fed at once.

    Attributes:
        log: of what has happened so far, with the status at the drive's end.
        over: whether it has ended.

    Args:
        simulation: that is driven, from the driver's start on.
        driver: that drives.
        mapper: that maps.
        seconds: simulated time to drive.
        wall_limit: wall seconds after which the drive is stopped; None = never.
        recorder: is shown every scan once it is mapped; its time counts.
        feeding: gives the mapper its scans, and is closed by who made it; None = at once.

    Raises:
        MapperError: the mapper failed (see `GuardedMapper`).
    """

    def __init__(
        self,
        simulation: Simulation,
        driver: Driver,
        mapper: Mapper | GuardedCloudMapper,
        seconds: float,
        *,
        wall_limit: float | None = None,
        recorder: Recorder | None = None,
        feeding: Feeding | None = None,
    ) -> None:
        self._simulation, self._driver = simulation, driver
        self._seconds, self._wall_limit, self._recorder = seconds, wall_limit, recorder
        self._ticks = max(1, math.ceil(seconds / simulation.period - 1e-9))
        self._tracking = LostRule()
        self._spent = 0.0
        self._given: deque[Tick] = deque()
        self._error: Exception | None = None
        spatial = isinstance(mapper, GuardedCloudMapper)
        self.log, self.over = DriveLog(driver.start, spatial), False
        self._feeding = feeding or DirectFeeding(mapper)
        self.log.mapper_in = self._feeding.place
        begun = time.perf_counter()
        self._give(simulation.reset(driver.start))
        self._note(begun)
        self.log.forget_times()  # The first scan comes before anything moves: no simulated time passes.

    @property
    def time(self) -> float:
        """Simulated seconds since the start, as far as the log goes."""
        return len(self.log.walls) * self._simulation.period

    def step(self, *, ahead: bool = True) -> None:
        """Drive for one tick.

        Args:
            ahead: whether the simulation may be driven further than this tick.

        Raises:
            MapperError: the mapper failed.
        """
        begun = time.perf_counter()
        try:
            if not self._given:
                self._advance()
        except SimulationError as error:
            self._end("diverged", str(error))
            return
        if ahead:
            self._look_ahead()
        tick, lost = self._note(begun)
        self._tracking.observe(tick.observation.scan.stamp, lost)
        self._spent += self.log.walls[-1]
        self._judge(tick)

    def catch_up(self) -> None:
        """Let the log come to where the simulation is; the mapper then is at rest.

        Raises:
            MapperError: the mapper failed.
        """
        while self._given:
            self.step(ahead=False)

    def _advance(self) -> None:
        """Drive the simulation for one tick, and give the mapper the scan.

        Raises:
            SimulationError: the simulation diverged.
        """
        if self._error is not None:
            raise self._error
        log, simulation, driver = self.log, self._simulation, self._driver
        pose = planar(simulation.T_world_base if driver.frame == "world" else log.estimates[-1])
        command = driver.command(pose, len(log.commands) * simulation.period)
        log.commands.append(command)
        self._give(simulation.advance(command))

    def _give(self, observation: Observation) -> None:
        """Give the mapper a scan; keep the simulation's state until it answers.

        It gets sensor data only.
        """
        self._feeding.give(observation)
        simulation = self._simulation
        has_cloud = self.log.spatial and observation.cloud is not None
        self._given.append(
            Tick(
                observation,
                simulation.T_world_base,
                simulation.time,
                walker_beams=simulation.walker_beams,
                walker_points=simulation.walker_points if has_cloud else None,
                failure=_failure(simulation, self._driver),
                finished=self._driver.finished,
            )
        )

    def _look_ahead(self) -> None:
        """Drive on while the mapper works."""
        while not self._feeding.ready and self._goes_on():
            try:
                self._advance()
            except Exception as error:  # is raised when its turn comes
                self._error = error

    def _goes_on(self) -> bool:
        """Return whether the drive certainly goes on after the last tick, whatever the answers."""
        first, last = self._given[0].observation.scan.stamp, self._given[-1]
        return (
            self._driver.frame == "world"
            and self._error is None
            and last.failure is None
            and not last.finished
            and len(self._given) < MOST_AHEAD
            and len(self.log.commands) < self._ticks
            and not self._late
            and not self._tracking.may_end(first, last.observation.scan.stamp, len(self._given))
        )

    @property
    def _late(self) -> bool:
        return self._wall_limit is not None and self._spent >= self._wall_limit

    def _note(self, begun: float) -> tuple[Tick, bool]:
        """Log the next tick, with the mapper's answer and the times.

        Returns:
            The tick, and whether the mapper does not know its place.
        """
        log, asked = self.log, time.perf_counter()
        answer = self._feeding.answer()
        log.waiting.append(time.perf_counter() - asked)
        tick = self._given.popleft()
        log.add(tick, answer.estimate)
        log.mapper_seconds.append(answer.seconds)
        if self._recorder is not None:
            self._recorder(tick.observation, tick.T_world_base, log.in_plane(answer.estimate))
        log.walls.append(time.perf_counter() - begun)
        return tick, answer.lost

    def _judge(self, tick: Tick) -> None:
        """End the drive if a tick requires it.

        Ticks that are already driven are evaluated first.
        """
        before_its_time = self.time < self._seconds
        if tick.failure is not None:
            self._end(*tick.failure)
        elif self._tracking.too_long is not None:
            self._end("lost", self._tracking.too_long)
        elif tick.finished and before_its_time:
            self._finish("ok", f"{tick.finished} at {tick.time:.1f} s")
        elif self._late and before_its_time and not self._given:
            self._finish("wall limit", _over(self._spent, tick.time, self._seconds))
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
    mapper: Mapper | GuardedCloudMapper,
    seconds: float,
    progress: Progress = no_progress,
    *,
    wall_limit: float | None = None,
    recorder: Recorder | None = None,
    feeding: Feeding | None = None,
) -> DriveLog:
    """Drive for a time, or until a failure or the wall limit.

    The log holds status and reason.

    Args:
        simulation: that is driven.
        driver: who drives.
        mapper: that is fed.
        seconds: simulated time.
        progress: of the drive.
        wall_limit: wall seconds after which the drive is stopped; None = never.
        recorder: is shown every scan once it is mapped; its time counts.
        feeding: gives the mapper its scans, and is closed by who made it; None = at once.

    Raises:
        MapperError: the mapper failed (see `GuardedMapper`).
    """
    taken = Drive(
        simulation,
        driver,
        mapper,
        seconds,
        wall_limit=wall_limit,
        recorder=recorder,
        feeding=feeding,
    )
    next_report = 1.0
    while not taken.over:
        taken.step()
        if taken.time >= next_report:
            progress("drive", taken.time / seconds)
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
