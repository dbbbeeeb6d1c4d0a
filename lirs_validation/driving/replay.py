"""Replay of a finished run's commands.

Other mappers and options then drive the same path.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import Twist, make_robot
from lirs_validation.config import RunConfig
from lirs_validation.driving.driver import Frame
from lirs_validation.record.run_record import read_record
from lirs_wct import ConfigError, LaserScan, Pose2, SourceError
from lirs_wct.formats.drive_csv import Commands, read_commands

COMMANDS = "commands.csv"
"""File of the driver's commands in a run's folder."""


class ReplayDriver:
    """Gives recorded commands, whatever comes of them."""

    frame: Frame = "world"
    stuck = False

    def __init__(self, commands: Commands, period: float, name: str) -> None:
        self._commands, self._period, self._name = commands, period, name
        self._given = 0

    @property
    def start(self) -> Pose2:
        """Start pose of the recorded run."""
        return self._commands.start

    @property
    def finished(self) -> str:
        """Why nothing is left to drive; empty while there is."""
        over = self._given >= len(self._commands.rows)
        return f"the commands of {self._name} end" if over else ""

    def sense(self, scan: LaserScan, odometry: Pose2) -> None:
        """Ignore scan and odometry."""

    def command(self, pose: Pose2, time: float) -> Twist:
        """Return the command that was given at this time; at rest after the last one."""
        at = round(time / self._period)
        self._given = at + 1
        rows = self._commands.rows
        return Twist(*rows[at, 1:].tolist()) if at < len(rows) else Twist()


def replay(folder: Path, config: RunConfig, world: str) -> ReplayDriver:
    """Return the driver that repeats a run.

    Raises:
        SourceError: the folder holds no run, or none whose commands were recorded.
        ConfigError: the run was one in another world, of another robot, or of a lidar with another period.
    """
    commands = read_replay(folder, config.robot)
    named = str(read_record(folder)["world"]["name"])
    if named != world:
        raise ConfigError(f"{folder}: drives through {named!r}, this run is in {world!r}: the same is needed")
    period = make_lidar_preset(config.lidar or make_robot(config.robot).lidar).period
    stamps = commands.rows[:, 0]
    if len(stamps) and np.abs(stamps - period * np.arange(len(stamps))).max() > period / 4:
        apart = stamps[-1] / max(1, len(stamps) - 1)
        raise ConfigError(
            f"{folder}: commands are {apart:g} s apart, this run's lidar scans each {period:g} s: "
            "the same lidar is needed"
        )
    return ReplayDriver(commands, period, folder.name)


def read_replay(folder: Path, robot: str) -> Commands:
    """Read the commands of a finished run of a robot."""
    found = read_record(folder)["config"]["robot"]
    if found != robot:
        raise ConfigError(f"{folder}: drives {found!r}, this run {robot!r}: the same robot is needed")
    path = folder / COMMANDS
    if not path.exists():
        raise SourceError(f"{path}: no such file: runs that came to nothing have none, nor have older ones")
    return read_commands(path)
