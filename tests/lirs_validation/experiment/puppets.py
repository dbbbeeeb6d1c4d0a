"""A simulation, its driver and a mapper, each of which can fail at a tick."""

import os
import time as clock
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lirs_envs.robots.robot import Twist
from lirs_envs.sensing.sensors import Observation
from lirs_validation.experiment.drive import DriveLog, drive
from lirs_validation.experiment.mapper_under_test import LocalMapper, MapperUnderTest
from lirs_wct.errors import SimulationError
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan


class Puppet:
    """Simulation and driver in one; `fails` names what fails from tick `at` on, or it is `finished`."""

    config = SimpleNamespace(actors=0)
    period = 0.04
    start = Pose2()
    frame = "world"

    def __init__(self, fails: str, at: int, finished: str = "") -> None:
        self.fails, self.at, self.ends, self.ticks = fails, at, finished, 0

    def _failing(self, name: str) -> bool:
        return self.fails == name and self.ticks >= self.at

    time = property(lambda self: (self.ticks - 1) * self.period)
    stuck = property(lambda self: self._failing("stuck"))
    finished = property(lambda self: self.ends if self.ticks >= self.at else "")

    def pose(self) -> Pose3:
        return Pose3()

    @property
    def mishap(self) -> str:
        return self.fails if self.fails in ("tipped", "off world") and self.ticks >= self.at else ""

    def reset(self, start: Pose2) -> Observation:
        return self.advance(Twist())

    def advance(self, command: Twist) -> Observation:
        self.ticks += 1
        if self._failing("diverged"):
            raise SimulationError("the simulation diverged: NaN in qacc")
        return Observation(LaserScan(np.ones(3, np.float32), 0, 0.1, 0.1, 9, self.time), Pose2(), Imu())

    def command(self, pose: Pose2, time: float, *_: object) -> Twist:
        if self._failing("driver"):
            raise ValueError("the driver has a bug")
        return Twist(time, 0.0)


class SlowPuppet:
    """A mapper that takes its time, answers with the scan's stamp as x, and is lost between two stamps."""

    def __init__(self, seconds: float = 0.002, *, lost: tuple[float, float] = (1e9, 1e9)) -> None:
        self.seconds, self.lost_between, self.stamps = seconds, lost, list[float]()

    @property
    def lost(self) -> bool:
        return bool(self.stamps) and self.lost_between[0] <= self.stamps[-1] < self.lost_between[1]

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        clock.sleep(self.seconds)
        self.stamps.append(scan.stamp)
        return Pose2(scan.stamp, 0.0, 0.0)

    @property
    def under_test(self) -> LocalMapper:
        return LocalMapper(self, "puppet")  # type: ignore[arg-type]


def drive_log(
    simulation: Any, driver: Any, mapper: MapperUnderTest, seconds: float, **options: Any
) -> DriveLog:
    """Return the log of a drive to its end."""
    log = DriveLog(driver.start, mapper.reads_clouds)
    for _ in drive(simulation, driver, mapper, log, seconds, **options):
        pass
    return log


def mapper_processes(parent: int | None = None) -> list[int]:
    """Return the ids of the mappers' processes of a process; of this one by default."""
    started = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if int((folder / "stat").read_text().rpartition(")")[2].split()[1]) == (parent or os.getpid()):
                started += [int(folder.name)] * (b"import serve" in (folder / "cmdline").read_bytes())
    return started
