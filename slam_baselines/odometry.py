"""Odometry as a prior: the pose to expect and how much to believe it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2, wrap_angle
from lirs_wct.scan import Imu

Array = NDArray[np.float64]


def yaw_rate(imu: Imu) -> float:
    """Return how fast yaw changes, rad/s: the body's rates turned into that of R = Rz Ry Rx."""
    _, y, z = imu.angular_velocity
    return (y * math.sin(imu.roll) + z * math.cos(imu.roll)) / max(math.cos(imu.pitch), 0.1)


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """Errors of the odometry, each as a random walk: the variance grows with way, turn and time.

    So a step in ten parts is as uncertain as the step in one, whatever the rate of the scans.

    Attributes:
        translation_per_metre: standard deviation after one metre, metres.
        translation_per_radian: after turning one radian, metres.
        translation_per_second: after one second, metres.
        rotation_per_metre: after one metre, radians.
        rotation_per_radian: after turning one radian, radians.
        rotation_per_second: after one second, radians.
        gyro_per_second: of a gyro's yaw after one second, radians.
        blind_translation: after one second without odometry, metres.
        blind_rotation: after one second without odometry, radians.

    Raises:
        ConfigError: a value is not above 0.
    """

    translation_per_metre: float = 0.04
    translation_per_radian: float = 0.02
    translation_per_second: float = 0.005
    rotation_per_metre: float = 0.03
    rotation_per_radian: float = 0.05
    rotation_per_second: float = 0.005
    gyro_per_second: float = 0.001
    blind_translation: float = 0.5
    blind_rotation: float = 0.5

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the motion must be above 0, got {getattr(self, name)}")

    def predict(
        self, pose: Pose2, covariance: Array, delta: Pose2 | None, seconds: float, turned: float | None = None
    ) -> tuple[Pose2, Array]:
        """Return the expected pose after a step and its (3, 3) covariance.

        Args:
            pose: before the step.
            covariance: (3, 3) of x, y, yaw there.
            delta: `T_before_now` by odometry; without it the robot is expected to stay, with little
                confidence.
            seconds: duration of the step.
            turned: change of yaw by the gyro, if there is one, radians. Two witnesses that agree are
                believed as a gyro deserves; the more they disagree, the less the odometry's yaw is.
        """
        seconds = max(seconds, 1e-3)
        if delta is None:
            delta = Pose2(yaw=turned or 0.0)
            shift, turn = self.blind_translation**2 * seconds, self.blind_rotation**2 * seconds
        else:
            metres, radians = math.hypot(delta.x, delta.y), abs(delta.yaw)
            shift = (
                self.translation_per_metre**2 * metres
                + self.translation_per_radian**2 * radians
                + self.translation_per_second**2 * seconds
            )
            turn = (
                self.rotation_per_metre**2 * metres
                + self.rotation_per_radian**2 * radians
                + self.rotation_per_second**2 * seconds
            )
        if turned is not None:
            turn = min(turn, self.gyro_per_second**2 * seconds + wrap_angle(turned - delta.yaw) ** 2)
        after = pose @ delta
        G = np.eye(3)
        G[0, 2], G[1, 2] = pose.y - after.y, after.x - pose.x
        return after, G @ covariance @ G.T + np.diag((shift, shift, turn))
