"""Interface of the drivers: poses and scans in, commands out."""

from __future__ import annotations

from typing import Literal, Protocol

from lirs_envs.robots.robot import Twist
from lirs_wct.geometry import LaserScan, Pose2

Frame = Literal["world", "map"]
"""Which poses a driver is given: `T_world_base`, the truth, or `T_map_base`, the mapper's latest answer."""


class Driver(Protocol):
    """Anything that drives a robot, one command a scan."""

    @property
    def start(self) -> Pose2:
        """Pose in the world frame where the robot is set down."""
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
        """Why nothing is left to drive; empty while there is."""
        ...

    def sense(self, scan: LaserScan, odometry: Pose2) -> None:
        """Receive the scan and `T_odom_base` that the next command follows."""

    def command(self, pose: Pose2, time: float) -> Twist:
        """Return the command for the next tick.

        Args:
            pose: of the robot, in the driver's frame.
            time: seconds since the start.
        """
        ...
