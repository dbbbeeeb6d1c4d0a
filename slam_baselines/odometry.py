"""Odometry as a prior: the pose to expect and how much to believe it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """Standard deviations of the motion since the last scan, after Thrun et al. 2005, table 5.6.

    Attributes:
        translation_per_metre: metres per metre driven.
        translation_per_radian: metres per radian turned.
        rotation_per_radian: radians per radian turned.
        rotation_per_metre: radians per metre driven.
        translation_floor: metres, of any step.
        rotation_floor: radians, of any step.
        blind_translation: metres per step when there is no odometry.
        blind_rotation: radians per step when there is no odometry.

    Raises:
        ConfigError: a negative value, or a floor that is not above 0.
    """

    translation_per_metre: float = 0.1
    translation_per_radian: float = 0.05
    rotation_per_radian: float = 0.1
    rotation_per_metre: float = 0.05
    translation_floor: float = 0.005
    rotation_floor: float = 0.005
    blind_translation: float = 0.3
    blind_rotation: float = 0.2

    def __post_init__(self) -> None:
        if min(self.translation_floor, self.rotation_floor) <= 0:
            raise ConfigError("translation_floor and rotation_floor must be above 0")
        if min(getattr(self, name) for name in self.__dataclass_fields__) < 0:
            raise ConfigError("standard deviations of motion must not be negative")

    def predict(self, pose: Pose2, covariance: Array, delta: Pose2 | None) -> tuple[Pose2, Array]:
        """Return the expected pose after a step `T_before_now` and its (3, 3) covariance.

        Without odometry (`delta` None) the robot is expected to stay, with little confidence.
        """
        if delta is None:
            noise = self.blind_translation, self.blind_rotation
            delta = Pose2()
        else:
            metres, radians = math.hypot(delta.x, delta.y), abs(delta.yaw)
            noise = (
                self.translation_per_metre * metres + self.translation_per_radian * radians + self.translation_floor,
                self.rotation_per_radian * radians + self.rotation_per_metre * metres + self.rotation_floor,
            )
        after = pose @ delta
        G = np.eye(3)
        G[0, 2], G[1, 2] = pose.y - after.y, after.x - pose.x
        Q = np.diag((noise[0] ** 2, noise[0] ** 2, noise[1] ** 2))
        return after, G @ covariance @ G.T + Q
