"""From a commanded twist to wheel speeds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lirs_envs.robots.command import Twist, Waypoint
from lirs_envs.robots.robot import Robot
from lirs_wct.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class DriveConfig:
    """Gains of the yaw loop, which trims what the feed-forward leaves.

    Attributes:
        proportional: extra turn rate per rad/s of error.
        integral: extra turn rate per radian of error.
        trim: largest integral part, rad/s.
    """

    proportional: float = 0.3
    integral: float = 4.0
    trim: float = 1.0

    def __post_init__(self) -> None:
        for name in ("proportional", "integral", "trim"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ConfigError(
                    f"drive: {name} must be a finite number of at least 0, got {getattr(self, name)}"
                )


class Drive:
    """Wheel speeds of a robot with driven wheels on both sides.

    The command is limited in speed and acceleration. A skid-steered robot turns slower than its wheels say,
    by a factor that depends on slope and load: `Robot.skid_factor` is fed forward, a PI loop on the gyro does
    the rest.
    """

    def __init__(self, robot: Robot, config: DriveConfig | None = None) -> None:
        self.robot = robot
        self.config = config or DriveConfig()
        self._v = self._omega = self._trim = 0.0

    def update(self, command: Twist | Waypoint, yaw_rate: float, dt: float) -> tuple[float, ...]:
        """Return the speeds of left and right wheels, rad/s.

        Args:
            command: wanted motion; beyond the robot's limits it is clipped.
            yaw_rate: measured by the gyro, rad/s.
            dt: time for which the speeds will hold, seconds.
        """
        assert isinstance(command, Twist), "a waypoint is for robots that fly"
        robot, config = self.robot, self.config
        v = _clip(command.v, robot.max_speed)
        omega = _clip(command.omega, robot.max_turn_rate)
        self._v += _clip(v - self._v, robot.max_acceleration * dt)
        self._omega += _clip(omega - self._omega, robot.max_turn_acceleration * dt)
        if self._v == 0.0 and self._omega == 0.0:
            # Standing: the wheels hold, the gyro's bias must not turn the robot.
            self._trim = 0.0
            return 0.0, 0.0
        error = self._omega - yaw_rate
        self._trim = _clip(self._trim + config.integral * error * dt, config.trim)
        turn = self._omega + config.proportional * error + self._trim
        side = turn * robot.skid_factor * robot.track / 2
        return (self._v - side) / robot.wheel_radius, (self._v + side) / robot.wheel_radius


def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
