"""Prediction of the next pose from velocities, as in the original's pose_extrapolator and imu_tracker.

Without IMU, the heading turns at the rate known at the last pose, so the rate of the odometry acts one scan
late. The translation uses the latest odometry.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from lirs_wct.geometry import Pose2, wrap_angle

MIN_INTERVAL = 0.001
"""Poses closer in time than this give no velocity, seconds."""


class StampedPose(NamedTuple):
    """A pose and its time, seconds."""

    stamp: float
    pose: Pose2


class Velocity(NamedTuple):
    """Velocity in the local frame, m/s and rad/s."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


class PoseExtrapolator:
    """Predicts poses in the local frame.

    Attributes:
        heading: sum of all predicted turns until the last pose, radians; the axes of the "gravity-aligned"
            frame in which scans are matched.
    """

    def __init__(self) -> None:
        self.heading = 0.0
        self._poses: list[StampedPose] = []
        self._odometry: list[StampedPose] = []
        self._by_poses = self._by_odometry = Velocity()
        self._turn_rate = 0.0

    @property
    def last_stamp(self) -> float:
        """Time of the last pose, seconds; -inf before the first."""
        return self._poses[-1].stamp if self._poses else -math.inf

    def add_pose(self, stamp: float, pose: Pose2) -> None:
        """Add a matched pose `T_local_base`."""
        self.heading = self.heading_at(stamp)
        self._poses.append(StampedPose(stamp, pose))
        while len(self._poses) > 2 and self._poses[1].stamp <= stamp - MIN_INTERVAL:
            del self._poses[0]
        oldest = self._poses[0]
        seconds = stamp - oldest.stamp
        if seconds >= MIN_INTERVAL:
            turn = wrap_angle(pose.yaw - oldest.pose.yaw)
            dx, dy = pose.x - oldest.pose.x, pose.y - oldest.pose.y
            self._by_poses = Velocity(dx / seconds, dy / seconds, turn / seconds)
        # Set after the heading has turned: the rate acts one scan late.
        self._turn_rate = self._velocity.turn
        self._trim()

    def add_odometry(self, stamp: float, odometry: Pose2) -> None:
        """Add odometry `T_odom_base`, not older than the last pose; ignored before the first."""
        if not self._poses:
            return
        self._odometry.append(StampedPose(stamp, odometry))
        self._trim()
        oldest = self._odometry[0]
        seconds = stamp - oldest.stamp
        if seconds <= 0:
            return
        back = odometry.inverse() @ oldest.pose
        yaw = self.predict(stamp).yaw
        # The step is in the axes of the newer pose.
        vx, vy = -back.x / seconds, -back.y / seconds
        c, s = math.cos(yaw), math.sin(yaw)
        self._by_odometry = Velocity(c * vx - s * vy, s * vx + c * vy, -back.yaw / seconds)

    def heading_at(self, stamp: float) -> float:
        """Return the heading at a time not before the last pose, radians."""
        return wrap_angle(self.heading + self._predict_turn(stamp))

    def predict(self, stamp: float) -> Pose2:
        """Return the pose `T_local_base` at a time not before the last pose."""
        last, velocity = self._poses[-1], self._velocity
        seconds = stamp - last.stamp
        pose, yaw = last.pose, wrap_angle(last.pose.yaw + self._predict_turn(stamp))
        return Pose2(pose.x + seconds * velocity.x, pose.y + seconds * velocity.y, yaw)

    @property
    def _velocity(self) -> Velocity:
        return self._by_poses if len(self._odometry) < 2 else self._by_odometry

    def _predict_turn(self, stamp: float) -> float:
        return self._turn_rate * (stamp - self.last_stamp) if self._poses else 0.0

    def _trim(self) -> None:
        """Drop odometry before the last that is not newer than the last pose."""
        while len(self._odometry) > 2 and self._odometry[1].stamp <= self.last_stamp:
            del self._odometry[0]
