"""A drive that runs while the page shows it, with manual or automatic driver."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from lirs_envs.robots.robot import Robot, Twist, clip
from lirs_validation.config import MANUAL, RunConfig, run_name
from lirs_validation.driving.driver import Driver, WrappedDriver
from lirs_validation.experiment.cost import CostMeter
from lirs_validation.experiment.drive import drive
from lirs_validation.experiment.evaluation import evaluate_drive, evaluate_maps
from lirs_validation.experiment.run import Run, conclude, prepare
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.playback import MapSnapshot, Playback
from lirs_validation.record.run_record import SUCCEEDED
from lirs_wct import LaserScan, MapperError, Pose2, World
from lirs_wct.progress import Progress, no_progress

MAP_SECONDS, MAP_WALL_SECONDS = 1.0, 0.5
"""Shortest simulated and wall-clock periods between two kept maps and verdicts, seconds."""


class HandOverDriver(WrappedDriver):
    """Driver that switches between another driver and manual control.

    Attributes:
        by_hand: Whether a person drives, within the robot's speed limits.
        touched: Whether a person drove at any time.
    """

    def __init__(self, driver: Driver, robot: Robot) -> None:
        super().__init__(driver)
        self._robot = robot
        self._wanted = Twist()
        self.by_hand = self.touched = False

    def steer(self, forward: float, left: float) -> None:
        """Set the stick's position: forward and left, -1 to 1 each."""
        self._wanted = Twist(
            clip(forward, 1.0) * self._robot.max_speed, clip(left, 1.0) * self._robot.max_turn_rate
        )

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up; a person never does."""
        return not self.by_hand and super().stuck

    @property
    def finished(self) -> str:
        """Reason for the end of the drive; empty before the end."""
        return "" if self.by_hand else super().finished

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return the command for the next tick."""
        if not self.by_hand:
            return self._driver.command(pose, time, scan, odometry)
        self.touched = True
        return self._wanted


class LiveDrive(Playback):
    """One drive of a page, from its first scan on.

    Attributes:
        config: Config of the run.
        driver: Driver of the config, from which a person can take over.

    Raises:
        WctError: the config cannot be run.
    """

    world: World

    def __init__(
        self, config: RunConfig, scenarios: ScenarioCache | None = None, progress: Progress = no_progress
    ) -> None:
        ready = prepare(config, progress, scenarios)
        super().__init__(config.robot, ready.scenario.world, ready.seconds)
        self.config, self.status = config, "driving"
        self.driver = HandOverDriver(ready.driver, ready.simulation.robot)
        self._ready = replace(ready, driver=self.driver)
        self._meter, self._log = CostMeter(), ready.log()
        limit = config.wall_limit
        self._ticks = drive(
            ready.simulation, self.driver, ready.mapper, self._log, ready.seconds, wall_limit=limit
        )
        next(self._ticks)
        self._T_world_map = self._log.truth[0].to_pose2()
        self._counted = {"loop closed": 0, "lost": 0}
        self._follow()
        self._take_stock()

    @property
    def over(self) -> bool:
        """Whether the drive has ended."""
        return self._log.over

    @property
    def failed(self) -> bool:
        """Whether the mapper failed; nothing can be saved then."""
        return self.over and self._log.status == "error"

    @property
    def repeated(self) -> RunConfig:
        """Config of a run that repeats this drive; one by hand repeats its saved folder."""
        if not self.driver.touched:
            return self.config
        by_hand = replace(self.config, driver=MANUAL)
        return replace(self.config, driver=f"replay:{run_name(by_hand, self.world.name)}")

    def step(self) -> None:
        """Drive until the next scan; nothing more once the drive is over.

        A mapper that fails ends the drive with the status `error`.
        """
        if self.over:
            return
        waited = time.monotonic() - self._drawn_at
        try:
            next(self._ticks, None)
            self._follow()
            if self.over or (self.time - self._stock_time >= MAP_SECONDS and waited >= MAP_WALL_SECONDS):
                self._take_stock()
        except MapperError as error:
            self._log.end("error", str(error))
            self._judge({})
        if self._log.status not in SUCCEEDED:
            self.marks.append((self.time, self._log.status))

    def drive_on(self, until: float, time_limit: float) -> None:
        """Continue the drive until a wall time or a simulated time (see `Playback`)."""
        while not self.over and time.monotonic() < until and self.time < time_limit:
            self.step()

    def save(self, out: Path, progress: Progress = no_progress) -> Run:
        """Evaluate and write the drive so far like `validate`; the drive can continue.

        The page shared the processor, so the record marks the real-time factor as concurrent. If a person
        drove, the record's driver is `manual`.

        Raises:
            WctError: nothing was driven yet, or the folder cannot be written.
        """
        log, ready = replace(self._log, concurrent=True), self._ready
        if not self.over:
            log.reason = f"stopped by hand at {self.time:.1f} s"
        if self.driver.touched:
            driven = replace(self.config, driver=MANUAL)
            ready = replace(ready, scenario=replace(ready.scenario, config=driven))
        return conclude(ready, log, ready.cost(self._meter), out, progress)

    def _follow(self) -> None:
        """Take new scans from the log, and the real-time factor of a new second."""
        log, period = self._log, self._ready.simulation.period
        for k in range(self.scans, len(log.truth)):
            estimate = self._T_world_map @ log.in_plane(log.estimates[k])
            self.add(log.scans[k], log.truth[k], (estimate.x, estimate.y))
        ticks = round(1.0 / period)
        if len(log.tick_seconds) == ticks * (len(self.rtf) + 1):
            self.rtf.append(ticks * period / sum(log.tick_seconds[-ticks:]))

    def _take_stock(self) -> None:
        """Keep the map, mark events and judge."""
        mapper, log, scores = self._ready.mapper, self._log, dict[str, Any]()
        if not mapper.reads_clouds:  # these have no occupancy map
            grid = mapper.map()
            self.maps.append(MapSnapshot.of(grid.moved(self._T_world_map), self.time))
            scores["occupied_cells"] = int(grid.occupied.sum())
        stats = mapper.stats
        for name, count in (("loop closed", stats.counts.get("loops", 0)), ("lost", stats.lost)):
            if count > self._counted[name]:
                self.marks.append((self.time, name))
            self._counted[name] = count
        if self.over and log.tick_seconds:
            log.final_trajectory = mapper.trajectory()
            scores = evaluate_maps(self.world, log, mapper).scores
        self._judge(scores)
        self._stock_time, self._drawn_at = self.time, time.monotonic()

    def _judge(self, map_scores: dict[str, Any]) -> None:
        """Judge the drive until now."""
        ready, log = self._ready, self._log
        record = evaluate_drive(ready.scenario, ready.simulation, log, map_scores)
        self.verdict = f"Verdict{'' if self.over else ' so far'}: {record.verdict}"
        if self.over:
            self.status = f"{log.status}{': ' if log.reason else ''}{log.reason}"
