"""The step since the last processed scan, by odometry and, where it can be had, corrected on the way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lirs_wct.pose import Pose2
from lirs_wct.scan import Imu
from slam_baselines.odometry import DeadReckoning, Estimate, MotionConfig

Array = NDArray[np.float64]


class Step:
    """How the base has moved since `begin`.

    Attributes:
        pose: `T_begin_now`, corrected.
        newest: (3, 3) covariance of what was added to it last.
        reckoned: the same step by dead reckoning alone; its covariance is the sum over the way.
        way: metres driven.
        turn: radians turned, either way.
    """

    def __init__(self, motion: MotionConfig) -> None:
        self._reckoning = DeadReckoning(motion)
        self.begin()

    def begin(self) -> None:
        """Start a new step here."""
        self.pose = Pose2()
        self.newest: Array = np.zeros((3, 3))
        self.reckoned = Estimate(Pose2(), self.newest)
        self.way = self.turn = 0.0

    def follow(self, odometry: Pose2, imu: Imu | None, stamp: float) -> Pose2:
        """Go on by odometry and gyro; return what was added, `T_before_now`."""
        exact = Estimate(self.pose, np.zeros((3, 3)))
        now = self._reckoning.predict(exact, odometry, imu, stamp)
        delta = self.pose.inverse() @ now.pose
        self.reckoned = Estimate(self.reckoned.pose @ delta, self.reckoned.covariance + now.covariance)
        self.pose, self.newest = now.pose, now.covariance
        self.way += math.hypot(delta.x, delta.y)
        self.turn += abs(delta.yaw)
        return delta
