"""Controllers of robots; control of driven wheels from a commanded twist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lirs_envs.robots.command import Twist, Waypoint
from lirs_envs.robots.flight import FlyingBody, QuadrotorController
from lirs_envs.robots.robot import Robot
from lirs_wct.arrays import FloatArray, RecordArray
from lirs_wct.field_validators import require_at_least
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.kernels import njit


@dataclass(frozen=True, kw_only=True)
class DriveConfig:
    """Gains of the yaw loop, which corrects the error of the feed-forward.

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


LIMITS = (
    "max_speed",
    "max_turn_rate",
    "max_acceleration",
    "max_turn_acceleration",
    "skid_factor",
    "track",
    "wheel_radius",
)
GAINS = ("proportional", "integral", "integral_limit")
DRIVE = np.dtype([(name, np.float64) for name in (*LIMITS, *GAINS)])
"""Limits of a robot and gains of its yaw loop as the kernel reads them: in an array, because a tuple of ten
numbers takes longer to hand over than the kernel runs."""


def drive_parameters(robot: Robot, config: DriveConfig) -> RecordArray:
    """Return (1,) of `DRIVE`: the parameters of a robot with driven wheels."""
    limits, gains = [getattr(robot, name) for name in LIMITS], [getattr(config, name) for name in GAINS]
    return np.array([(*limits, *gains)], DRIVE)


class DifferentialDrive:
    """Wheel speeds of a robot with driven wheels on both sides.

    The command is limited in speed and acceleration. A skid-steered robot turns slower than its wheels imply,
    by a factor that depends on slope and load. `Robot.skid_factor` is fed forward, and a PI loop on the gyro
    corrects the remaining error.
    """

    def __init__(self, robot: Robot, config: DriveConfig | None = None) -> None:
        self.robot = robot
        self.config = config or DriveConfig()
        self._parameters = drive_parameters(robot, self.config)
        self._state = np.zeros(3)

    def update(self, command: Twist | Waypoint, yaw_rate: float, dt: float) -> tuple[float, ...]:
        """Return the speeds of left and right wheels, rad/s (see `robots.controller.Controller`)."""
        assert isinstance(command, Twist), "a waypoint is for robots that fly"
        v, omega = float(command.v), float(command.omega)
        speeds: tuple[float, float] = wheel_speeds(self._state, v, omega, yaw_rate, dt, self._parameters)
        return speeds


@njit(cache=True, nogil=True)
def wheel_speeds(
    state: FloatArray, v: float, omega: float, yaw_rate: float, dt: float, parameters: RecordArray
) -> tuple[float, float]:
    """Return the speeds of left and right wheels, rad/s, and update the state.

    Args:
        state: (3,) commanded speed and turn rate within the accelerations, integral of the yaw loop.
        v: commanded speed, m/s.
        omega: commanded turn rate, rad/s.
        yaw_rate: measured by the gyro, rad/s.
        dt: seconds until the next update.
        parameters: (1,) of `DRIVE`.
    """
    p = parameters[0]
    v, omega = _limit(v, p.max_speed), _limit(omega, p.max_turn_rate)
    state[0] += _limit(v - state[0], p.max_acceleration * dt)
    state[1] += _limit(omega - state[1], p.max_turn_acceleration * dt)
    if state[0] == 0.0 and state[1] == 0.0:
        # Standing: the wheels hold, the gyro's bias must not turn the robot.
        state[2] = 0.0
        return 0.0, 0.0
    error = state[1] - yaw_rate
    state[2] = _limit(state[2] + p.integral * error * dt, p.integral_limit)
    side = (state[1] + p.proportional * error + state[2]) * p.skid_factor * p.track / 2
    return (state[0] - side) / p.wheel_radius, (state[0] + side) / p.wheel_radius


@njit(cache=True, inline="always")
def _limit(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


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
    """Return the controller of a robot; `body` and `surface` serve flying robots."""
    return QuadrotorController(robot, body, surface) if robot.flies else DifferentialDrive(robot)
