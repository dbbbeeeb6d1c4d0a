"""The online loop: driver, simulation and mapper, one lidar period at a time, on the clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lirs_envs.sensing.sensors import Observation
from lirs_envs.simulation import Simulation
from lirs_validation.driving.driver import Driver
from lirs_validation.experiment.clouds.guard import GuardedCloudMapper
from lirs_validation.experiment.drive_log import DriveLog
from lirs_validation.record.run_record import Status
from lirs_validation.record.verdict import LostRule
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.progress import Progress, no_progress
from slam_baselines.mapper import Mapper

Recorder = Callable[[Observation, Pose3, Pose2], None]
"""Is shown what was sensed, the cloud included, the true pose `T_world_base` and the mapper's answer
`T_map_base`, in the plane."""


class Drive:
    """A drive that is taken tick by tick, until its time is over, something fails or its driver is done.

    Attributes:
        log: of what has happened so far; it says how the drive ended.
        over: whether it has ended.

    Args:
        simulation: that is driven, from the driver's start on.
        driver: that drives.
        mapper: that maps.
        seconds: simulated time to drive.
        wall_limit: wall seconds after which the drive is stopped; None = never.
        recorder: is shown every scan once it is mapped; its time counts.
        spool: folder of the log's nameless files; None = the system's for temporary files.

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
        spool: Path | None = None,
    ) -> None:
        self._simulation, self._driver, self._mapper = simulation, driver, mapper
        self._seconds, self._wall_limit, self._recorder = seconds, wall_limit, recorder
        self._ticks = max(1, math.ceil(seconds / simulation.period - 1e-9))
        self._tracking = LostRule()
        self._spent = 0.0
        spatial = isinstance(mapper, GuardedCloudMapper)
        self.log, self.over = DriveLog.begin(driver.start, spatial=spatial, folder=spool), False
        _map(self.log, simulation.reset(driver.start), simulation, mapper, time.perf_counter(), recorder)
        # The first scan comes before anything moves: no simulated time passes, so none is counted.
        del self.log.walls[:], self.log.mapper_seconds[:]

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""
        return len(self.log.walls) * self._simulation.period

    def step(self) -> None:
        """Drive for one tick.

        Raises:
            MapperError: the mapper failed.
        """
        log, simulation, driver = self.log, self._simulation, self._driver
        begun = time.perf_counter()
        pose = planar(simulation.T_world_base if driver.frame == "world" else log.estimates[-1])
        command = driver.command(pose, self.time)
        log.commands.append(command)
        try:
            observation = simulation.advance(command)
        except SimulationError as error:
            self._end("diverged", str(error))
            return
        _map(log, observation, simulation, self._mapper, begun, self._recorder)
        self._tracking.observe(observation.scan.stamp, self._mapper.lost)
        self._spent += log.walls[-1]
        self._judge()

    def stop(self, reason: str) -> None:
        """End the drive before its time; a place that was lost for long is still said."""
        self._finish("ok", reason)

    def _judge(self) -> None:
        """End the drive where a tick gave reason to."""
        before_its_time = self.time < self._seconds
        failure = _failure(self._simulation, self._driver, self._tracking)
        if failure is not None:
            self._end(*failure)
        elif self._driver.finished and before_its_time:
            self._finish("ok", f"{self._driver.finished} at {self._simulation.time:.1f} s")
        elif self._wall_limit is not None and self._spent >= self._wall_limit and before_its_time:
            self._finish("wall limit", _over(self._spent, self._simulation.time, self._seconds))
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
    spool: Path | None = None,
) -> DriveLog:
    """Drive for a time, or until something fails or the wall limit is over; the log says which.

    Args:
        simulation: that is driven.
        driver: who drives.
        mapper: that is fed.
        seconds: simulated time.
        progress: of the drive.
        wall_limit: wall seconds after which the drive is stopped; None = never.
        recorder: is shown every scan once it is mapped; its time counts.
        spool: folder of the log's nameless files; None = the system's for temporary files.

    Raises:
        MapperError: the mapper failed (see `GuardedMapper`).
    """
    taken = Drive(simulation, driver, mapper, seconds, wall_limit=wall_limit, recorder=recorder, spool=spool)
    next_report = 1.0
    while not taken.over:
        taken.step()
        if taken.time >= next_report:
            progress("drive", taken.time / seconds)
            next_report += 1.0
    return taken.log


def _map(
    log: DriveLog,
    observation: Observation,
    simulation: Simulation,
    mapper: Mapper | GuardedCloudMapper,
    begun: float,
    recorder: Recorder | None,
) -> None:
    """Feed the mapper, and nothing but sensors; then note what happened and how long it took."""
    handed = time.perf_counter()
    estimate = fed(mapper, observation)
    done = time.perf_counter()
    if observation.cloud is not None and isinstance(mapper, GuardedCloudMapper):
        log.clouds.offer(len(log.observations), observation.cloud, simulation.walker_points)
    log.observations.append(observation)
    walker_beams = simulation.walker_beams
    if walker_beams is not None:
        log.walker_beams.append(walker_beams)
    T_world_base = simulation.T_world_base
    log.truth.append(T_world_base)
    log.estimates.append(estimate)  # type: ignore[arg-type]  # of the mapper's kind
    log.mapper_seconds.append(done - handed)
    if recorder is not None:
        recorder(observation, T_world_base, log.in_plane(estimate))
    log.walls.append(time.perf_counter() - begun)


def fed(mapper: Mapper | GuardedCloudMapper, observation: Observation) -> Pose2 | Pose3:
    """Give a mapper what it reads of an observation; return its answer.

    Raises:
        ConfigError: it reads point clouds, and the lidar has no rings.
    """
    if not isinstance(mapper, GuardedCloudMapper):
        return mapper.update(observation.scan, observation.odometry, observation.imu)
    if observation.cloud is None:
        raise ConfigError("a mapper of point clouds needs a lidar with rings")
    return mapper.update(observation.cloud, observation.imu)


def planar(pose: Pose2 | Pose3) -> Pose2:
    """Return a pose projected on the plane."""
    return pose.to_pose2() if isinstance(pose, Pose3) else pose


def _failure(simulation: Simulation, driver: Driver, tracking: LostRule) -> tuple[Status, str] | None:
    if simulation.tipped:
        return "tipped", f"the robot tipped over at {simulation.time:.1f} s"
    if simulation.off_world:
        return "off world", f"the robot left the world at {simulation.time:.1f} s"
    if driver.stuck:
        return "stuck", f"the robot made no progress and gave up at {simulation.time:.1f} s"
    return None if tracking.too_long is None else ("lost", tracking.too_long)


def _over(spent: float, driven: float, seconds: float) -> str:
    return (
        f"stopped at the wall limit, after {spent:.1f} s for {driven:.1f} of {seconds:g} simulated seconds; "
        "its real-time factor is extrapolated from these"
    )


def per_second(values: Sequence[float], period: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return (n,) sums of per-tick values over each whole simulated second (a rest counts by its share)."""
    ticks = max(1, round(1.0 / period))
    whole = [values[i : i + ticks] for i in range(0, len(values), ticks)]
    return np.array([sum(part) / (len(part) * period) for part in whole if part], dtype=np.float64)
