"""From a commanded twist to wheel speeds, and from wheel angles and gyro to odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_envs.robots import Robot
from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2, wrap_angle


@dataclass(frozen=True, slots=True)
class Twist:
    """A commanded motion of the base.

    Attributes:
        v: speed ahead, m/s.
        omega: turn rate, rad/s, counter-clockwise.
    """

    v: float = 0.0
    omega: float = 0.0


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

    def update(self, command: Twist, yaw_rate: float, dt: float) -> tuple[float, float]:
        """Return the speeds of left and right wheels, rad/s.

        Args:
            command: wanted motion; beyond the robot's limits it is clipped.
            yaw_rate: measured by the gyro, rad/s.
            dt: time for which the speeds will hold, seconds.
        """
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


@dataclass(frozen=True, kw_only=True)
class OdometryConfig:
    """Noise of wheel odometry; slip on the ground comes from the simulation and adds to it.

    Attributes:
        scale_sigma: standard deviation of the distance's scale error, which wanders while the robot drives.
        scale_length: distance over which it wanders, metres (first-order Gauss-Markov process).
    """

    scale_sigma: float = 0.02
    scale_length: float = 5.0

    def __post_init__(self) -> None:
        if not (0 <= self.scale_sigma < 1 and 0 < self.scale_length < math.inf):
            raise ConfigError(
                "odometry: scale_sigma must be in [0, 1) and scale_length above 0 m, "
                f"got {self.scale_sigma} and {self.scale_length}"
            )


class Odometry:
    """`T_odom_base` as a robot publishes it: distance from its wheels, heading from its gyro.

    The yaw of skid-steered wheels is useless (they slip by design), which is why robots of this kind fuse the
    gyro; its noise and bias are the IMU's. The distance is laid into the plane by the IMU's attitude.
    The frame is the base's pose when the odometry is made.
    """

    def __init__(self, robot: Robot, config: OdometryConfig, rng: np.random.Generator) -> None:
        self.robot = robot
        self.config = config
        self._rng = rng
        self._scale = config.scale_sigma * float(rng.standard_normal())
        self.pose = Pose2()

    def update(
        self, turned: float, rates: tuple[float, float, float], roll: float, pitch: float, dt: float
    ) -> None:
        """Add a piece of way.

        Args:
            turned: mean angle by which the wheels have turned, radians.
            rates: measured rates about x, y, z of the base, rad/s.
            roll: measured attitude, radians.
            pitch: measured attitude, radians.
            dt: seconds.
        """
        length = turned * self.robot.wheel_radius
        config = self.config
        keep = math.exp(-abs(length) / config.scale_length)
        noise = config.scale_sigma * math.sqrt(1 - keep * keep) * float(self._rng.standard_normal())
        self._scale = keep * self._scale + noise
        ahead = length * (1 + self._scale) * math.cos(pitch)
        # Rate of the yaw angle for R = Rz Ry Rx.
        yaw_rate = (rates[1] * math.sin(roll) + rates[2] * math.cos(roll)) / max(math.cos(pitch), 0.1)
        turn = yaw_rate * dt
        middle = self.pose.yaw + turn / 2
        self.pose = Pose2(
            self.pose.x + ahead * math.cos(middle),
            self.pose.y + ahead * math.sin(middle),
            wrap_angle(self.pose.yaw + turn),
        )


def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
