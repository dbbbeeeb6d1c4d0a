"""Interface of the drivers, and drivers around another one: standing still first, driving backwards."""

from __future__ import annotations

import math
from typing import Literal, Protocol

from lirs_envs.robots.robot import Twist
from lirs_wct.geometry import LaserScan, Pose2

Frame = Literal["world", "map"]
"""Frame of a driver's poses: `T_world_base`, the truth, or `T_map_base`, the mapper's latest answer."""


class Driver(Protocol):
    """Anything that drives a robot, one command a scan."""

    @property
    def start(self) -> Pose2:
        """Start pose of the robot, world frame."""
        ...

    @property
    def frame(self) -> Frame:
        """Frame of the poses that `command` receives."""
        ...

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up."""
        ...

    @property
    def finished(self) -> str:
        """Reason why nothing is left to drive; empty while there is."""
        ...

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return the command for the next tick.

        Args:
            pose: Pose of the robot, in the driver's frame.
            time: Seconds since the start.
            scan: Latest scan.
            odometry: `T_odom_base` at the scan.
        """
        ...


class WrappedDriver:
    """Base of drivers around another one, with its start, frame and end."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver

    @property
    def start(self) -> Pose2:
        """Start pose of the robot."""
        return self._driver.start

    @property
    def frame(self) -> Frame:
        """Frame of the poses that the driver gets."""
        return self._driver.frame

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up."""
        return self._driver.stuck

    @property
    def finished(self) -> str:
        """Reason for the end of the drive; empty before the end."""
        return self._driver.finished


class StandingDriver(WrappedDriver):
    """Driver that hands over to another one after some simulated seconds at rest."""

    def __init__(self, driver: Driver, seconds: float) -> None:
        super().__init__(driver)
        self._seconds = seconds

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return no motion at first, then the driver's command (see `Driver.command`)."""
        # Half a microsecond: sums of periods are not exact.
        if time < self._seconds - 5e-7:
            return Twist()
        return self._driver.command(pose, time - self._seconds, scan, odometry)


CYCLE = 20.0
"""Seconds of one turn of forward and backward driving."""
BACK = Pose2(0.0, 0.0, math.pi)


class ReversingDriver(WrappedDriver):
    """Driver that follows the path of another one backwards for a share of the time."""

    def __init__(self, driver: Driver, share: float) -> None:
        super().__init__(driver)
        self._share = share

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return the driver's command, or the reversed one for a robot that faces backwards."""
        if time % CYCLE < (1.0 - self._share) * CYCLE:
            return self._driver.command(pose, time, scan, odometry)
        wanted = self._driver.command(pose @ BACK, time, scan, odometry)
        return Twist(-wanted.v, wanted.omega)
