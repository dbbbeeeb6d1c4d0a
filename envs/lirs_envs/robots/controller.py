"""What turns commands into a robot's actuator controls."""

from __future__ import annotations

from typing import Protocol

from lirs_envs.robots.command import Twist, Waypoint
from lirs_envs.robots.drive import DifferentialDrive
from lirs_envs.robots.flight import FlyingBody, QuadrotorController
from lirs_envs.robots.robot import Robot
from lirs_wct.geometry.heightfield import HeightField


class Controller(Protocol):
    """Actuator controls from commands."""

    def update(self, command: Twist | Waypoint, yaw_rate: float, dt: float) -> tuple[float, ...]:
        """Return the controls to hold for `dt` seconds: wheel speeds, rad/s, or rotor thrusts, newtons.

        Args:
            command: beyond the robot's limits it is clipped.
            yaw_rate: measured by the gyro, rad/s.
            dt: seconds.
        """


def make_controller(robot: Robot, body: FlyingBody, surface: HeightField) -> Controller:
    """Return the controller of a robot; `body` and `surface` are what a flying one senses."""
    return QuadrotorController(robot, body, surface) if robot.flies else DifferentialDrive(robot)
