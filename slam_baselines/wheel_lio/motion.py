"""Expected motion in space by wheels, gyro and gravity."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import Imu, ImuReadings, Pose2, Pose3
from slam_baselines.motion.spatial import climb
from slam_baselines.wheel_lio.sweep import BodyTwist

GRAVITY = np.array((0.0, 0.0, 9.80665))
STANDING = 1e-5
"""Motion of the wheels between two sweeps up to which the robot stands, meters."""
STILL = math.radians(1.0)
"""Yaw rate of the odometry up to which the robot stands, and does not turn on the spot, rad/s."""
REST = 100
"""Readings of a standing robot that are needed for the bias of its gyro."""
LATEST = 2
"""Last readings of the gyro that give the rate at a sweep's stamp."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Expected state at a sweep's stamp.

    Attributes:
        R: (3, 3) rotation of the base in the level map frame.
        t: (3,) position, meters.
        twist: velocity of the base.
        step: planar step of the odometry since the last sweep.
        seconds: duration of that step.
    """

    R: FloatArray
    t: FloatArray
    twist: BodyTwist
    step: Pose2
    seconds: float


class Motion:
    """Dead reckoning from sweep to sweep, from corrected poses.

    The bias of the gyro is its mean while the robot stands.

    Args:
        tilt_time: seconds within which the tilt follows the measured one.
    """

    def __init__(self, tilt_time: float) -> None:
        self._tilt_time = tilt_time
        self._R, self._t = np.eye(3), np.zeros(3)
        self._odometry: Pose2 | None = None
        self._stamp = 0.0
        self._resting_sum, self._resting = np.zeros(3), 0

    def correct(self, R: FloatArray, t: FloatArray) -> None:
        """Set the pose at the last stamp."""
        self._R, self._t = R, t

    def predict(self, stamp: float, odometry: Pose2, imu: Imu | None, readings: ImuReadings) -> Prediction:
        """Return the expected state at a stamp; the first position is the origin.

        Args:
            stamp: seconds.
            odometry: `T_odom_base` at the stamp.
            imu: roll and pitch at the stamp; without them, the tilt is the gyro's.
            readings: since the last stamp.
        """
        before, self._odometry = self._odometry, odometry
        seconds, self._stamp = stamp - self._stamp, stamp
        if before is None:
            R = np.eye(3) if imu is None else Pose3.from_rpy(0, 0, 0, imu.roll, imu.pitch, 0).rotation
            return Prediction(R, np.zeros(3), BodyTwist(np.zeros(3), np.zeros(3)), Pose2(), 0.0)
        step = before.inverse() @ odometry
        if math.hypot(step.x, step.y) < STANDING and abs(step.yaw) < STILL * seconds:
            self._learn_bias(readings)
        R = self._R @ self._turn(step, seconds, readings)
        if imu is not None:
            R = level(R, imu, -math.expm1(-seconds / self._tilt_time))
        shift = self._shift(step, R)
        velocity = shift / seconds
        if imu is not None:
            velocity = velocity + gained_velocity(readings, R, seconds)
        twist = BodyTwist(R.T @ velocity, self._rates(step, seconds, readings))
        return Prediction(R, self._t + shift, twist, step, seconds)

    @property
    def bias(self) -> FloatArray:
        """(3,) of the gyro, rad/s; 0 until the robot has stood."""
        return self._resting_sum / self._resting if self._resting >= REST else np.zeros(3)

    def _learn_bias(self, readings: ImuReadings) -> None:
        """Add the readings of a standing robot."""
        self._resting_sum = self._resting_sum + readings.angular_velocity.sum(axis=0)
        self._resting += len(readings)

    def _turn(self, step: Pose2, seconds: float, readings: ImuReadings) -> FloatArray:
        """Return the rotation of a step (3, 3) by the gyro, else by the odometry."""
        if not len(readings):
            return Pose3.from_pose2(step).rotation
        turn = Rotation.identity()
        for angle in (readings.angular_velocity - self.bias) * (seconds / len(readings)):
            turn = turn * Rotation.from_rotvec(angle)
        matrix: FloatArray = turn.as_matrix()
        return matrix

    def _shift(self, step: Pose2, R: FloatArray) -> FloatArray:
        """Return the shift of a step (3,) in the map frame."""
        yaw = math.atan2(self._R[1, 0], self._R[0, 0])
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = c * step.x - s * step.y, s * step.x + c * step.y
        return np.array((dx, dy, climb(dx, dy, self._R[:, 2] + R[:, 2])))

    def _rates(self, step: Pose2, seconds: float, readings: ImuReadings) -> FloatArray:
        """Return the rates (3,) at the end of a step, rad/s."""
        if not len(readings):
            return np.array((0.0, 0.0, step.yaw / seconds))
        rates: FloatArray = readings.angular_velocity[-LATEST:].mean(axis=0) - self.bias
        return rates


def gained_velocity(readings: ImuReadings, R: FloatArray, seconds: float) -> FloatArray:
    """Return the velocity (3,) gained from the mean to the end of a step, m/s.

    It is the integral of t a(t) / T over the step's T seconds, with the accelerations a at the attitude R.
    """
    n = len(readings)
    if not n:
        return np.zeros(3)
    share = (np.arange(n) + 0.5) / n
    gained: FloatArray = share @ (readings.linear_acceleration @ R.T - GRAVITY) * (seconds / n)
    return gained


def level(R: FloatArray, imu: Imu, share: float) -> FloatArray:
    """Return a rotation (3, 3) turned toward the measured roll and pitch by a share."""
    sr, cr, sp, cp = math.sin(imu.roll), math.cos(imu.roll), math.sin(imu.pitch), math.cos(imu.pitch)
    x, y, _ = R @ np.array((-sp, sr * cp, cr * cp))
    turned: FloatArray = Rotation.from_rotvec((share * y, -share * x, 0.0)).as_matrix() @ R
    return turned
