"""From wheel angles and gyro to odometry: dead reckoning, or the filter of `ekf`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from lirs_envs.robots.robot import Robot
from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.geometry.pose import Pose2, Pose3, wrap_angle

Method = Literal["gyro", "ekf"]
METHODS: tuple[Method, ...] = get_args(Method)
BLOCK = 256
"""Random numbers that are drawn at once: one by one, each costs as much as the rest of the update."""


@dataclass(frozen=True, kw_only=True)
class OdometryConfig:
    """Noise of wheel odometry, and how it is fused; slip comes from the simulation and adds to it.

    Attributes:
        scale_sigma: standard deviation of the distance's scale error, which wanders while the robot drives.
        scale_length: distance over which it wanders, metres (first-order Gauss-Markov process).
        method: `gyro` = distance from the wheels, heading from the gyro; `ekf` = a Kalman filter over both,
            which learns the gyro's bias where the wheels tell the turn: standing, or with one driven axle.

    Raises:
        ConfigError: a figure is not legal.
    """

    scale_sigma: float = 0.02
    scale_length: float = 5.0
    method: Method = "gyro"

    def __post_init__(self) -> None:
        if not (0 <= self.scale_sigma < 1 and 0 < self.scale_length < math.inf):
            raise ConfigError(
                "odometry: scale_sigma must be in [0, 1) and scale_length above 0 m, "
                f"got {self.scale_sigma} and {self.scale_length}"
            )
        if self.method not in METHODS:
            raise unknown_name("odometry method", self.method, METHODS)


class Way(NamedTuple):
    """What wheels and IMU say about one piece of way.

    Attributes:
        length: driven, by the wheels, metres.
        wheel_turn: turned, by the difference between the wheels, radians.
        rates: of the gyro about x, y, z of the base, rad/s.
        roll: attitude, radians.
        pitch: attitude, radians.
        dt: seconds.
    """

    length: float
    wheel_turn: float
    rates: tuple[float, float, float]
    roll: float
    pitch: float
    dt: float

    @property
    def ahead(self) -> float:
        """Length laid into the plane, metres."""
        return self.length * math.cos(self.pitch)

    @property
    def turn(self) -> float:
        """Change of the yaw angle by the gyro (R = Rz Ry Rx), radians."""
        _, y, z = self.rates
        return (y * math.sin(self.roll) + z * math.cos(self.roll)) / max(math.cos(self.pitch), 0.1) * self.dt


class WheelNoise:
    """The scale error of distances: a first-order Gauss-Markov process over the way driven."""

    def __init__(self, config: OdometryConfig, rng: np.random.Generator) -> None:
        self.config = config
        self._rng = rng
        self._normals: list[float] = []
        self._scale = config.scale_sigma * self._normal()

    def measured(self, length: float) -> float:
        """Return a length as the wheels tell it, metres."""
        keep = math.exp(-abs(length) / self.config.scale_length)
        noise = self.config.scale_sigma * math.sqrt(1 - keep * keep) * self._normal()
        self._scale = keep * self._scale + noise
        return length * (1 + self._scale)

    def _normal(self) -> float:
        if not self._normals:
            self._normals = self._rng.standard_normal(BLOCK)[::-1].tolist()
        return self._normals.pop()


class Odometry:
    """`T_odom_base` as a robot publishes it: distance from its wheels, heading from its gyro.

    The yaw of skid-steered wheels is useless (they slip by design), which is why robots of this kind fuse the
    gyro; its noise and bias are the IMU's. The distance is laid into the plane by the IMU's attitude.
    The frame is the base's pose when the odometry is made.
    """

    def __init__(self, robot: Robot, config: OdometryConfig, rng: np.random.Generator) -> None:
        self.robot = robot
        self.config = config
        self._wheels = WheelNoise(config, rng)
        self.pose = Pose2()

    def update(
        self,
        turned: float,
        rates: tuple[float, float, float],
        roll: float,
        pitch: float,
        dt: float,
        difference: float = 0.0,
    ) -> None:
        """Add a piece of way.

        Args:
            turned: mean angle by which the wheels have turned, radians.
            rates: measured rates about x, y, z of the base, rad/s.
            roll: measured attitude, radians.
            pitch: measured attitude, radians.
            dt: seconds.
            difference: angle by which the right wheels have turned more than the left ones, radians.
        """
        robot = self.robot
        length = self._wheels.measured(turned * robot.wheel_radius)
        wheel_turn = difference * robot.wheel_radius / (robot.track * robot.skid_factor)
        self._add(Way(length, wheel_turn, rates, roll, pitch, dt))

    def read(self) -> Pose2:
        """Return `T_odom_base` after all that was added."""
        return self.pose

    def _add(self, way: Way) -> None:
        self.pose = integrated(self.pose, way.ahead, way.turn)


class FlowOdometry(Odometry):
    """Odometry of a robot that flies: velocity over ground by a camera that looks down, heading by the gyro.

    The velocity has the scale error of the config, as an optical flow has by its height.
    """

    def flow(
        self,
        T_world_base: Pose3,
        velocity: tuple[float, float, float],
        rates: tuple[float, float, float],
        roll: float,
        pitch: float,
        dt: float,
    ) -> None:
        """Add a piece of way.

        Args:
            T_world_base: true pose.
            velocity: true, along x, y, z of the base, m/s.
            rates: measured rates about x, y, z of the base, rad/s.
            roll: measured attitude, radians.
            pitch: measured attitude, radians.
            dt: seconds.
        """
        east, north, _ = (T_world_base.rotation @ np.array(velocity) * dt).tolist()
        c, s = math.cos(T_world_base.yaw), math.sin(T_world_base.yaw)
        length = math.hypot(east, north)
        scale = self._wheels.measured(length) / length if length > 0 else 1.0
        turn = Way(0.0, 0.0, rates, roll, pitch, dt).turn
        # True yaw's axes: what the camera sees is turned with the body.
        moved = Pose2((c * east + s * north) * scale, (c * north - s * east) * scale, turn)
        self.pose = self.pose @ moved


def integrated(pose: Pose2, ahead: float, turn: float) -> Pose2:
    """Return a pose after a short piece of way: metres ahead while turning by radians."""
    middle = pose.yaw + turn / 2
    return Pose2(
        pose.x + ahead * math.cos(middle), pose.y + ahead * math.sin(middle), wrap_angle(pose.yaw + turn)
    )
