"""Control of a robot with driven wheels: from a commanded twist to wheel speeds."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_envs.robots.command import Twist, Waypoint, clip
from lirs_envs.robots.robot import Robot
from lirs_wct.field_validators import require_at_least


@dataclass(frozen=True, kw_only=True)
class DriveConfig:
    """Gains of the yaw loop, which trims what the feed-forward leaves.

    Attributes:
        proportional: extra turn rate per rad/s of error.
        integral: extra turn rate per radian of error.
        integral_limit: largest integral part, rad/s.

    Raises:
        ConfigError: a gain is negative or not finite.
    """

    proportional: float = 0.3
    integral: float = 4.0
    integral_limit: float = 1.0

    def __post_init__(self) -> None:
        names = ("proportional", "integral", "integral_limit")
        require_at_least(self, 0, *names, of="the yaw loop", finite=True)


class DifferentialDrive:
    """Wheel speeds of a robot with driven wheels on both sides.

    The command is limited in speed and acceleration. A skid-steered robot turns slower than its wheels imply,
    by a factor that depends on slope and load: `Robot.skid_factor` is fed forward, a PI loop on the gyro does
    the rest.
    """

    def __init__(self, robot: Robot, config: DriveConfig | None = None) -> None:
        self.robot = robot
        self.config = config or DriveConfig()
        self._v = self._omega = self._integral = 0.0

    def update(self, command: Twist | Waypoint, yaw_rate: float, dt: float) -> tuple[float, ...]:
        """Return the speeds of left and right wheels, rad/s (see `robots.controller.Controller`)."""
        assert isinstance(command, Twist), "a waypoint is for robots that fly"
        robot, config = self.robot, self.config
        v = clip(command.v, robot.max_speed)
        omega = clip(command.omega, robot.max_turn_rate)
        self._v += clip(v - self._v, robot.max_acceleration * dt)
        self._omega += clip(omega - self._omega, robot.max_turn_acceleration * dt)
        if self._v == 0.0 and self._omega == 0.0:
            # Standing: the wheels hold, the gyro's bias must not turn the robot.
            self._integral = 0.0
            return 0.0, 0.0
        error = self._omega - yaw_rate
        self._integral = clip(self._integral + config.integral * error * dt, config.integral_limit)
        turn = self._omega + config.proportional * error + self._integral
        side = turn * robot.skid_factor * robot.track / 2
        return (self._v - side) / robot.wheel_radius, (self._v + side) / robot.wheel_radius
