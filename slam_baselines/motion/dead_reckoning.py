"""Dead reckoning: expected pose and covariance by odometry and gyro, in the plane and in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.checks import Checked, limited
from lirs_wct.geometry import Imu, Pose2, Pose3, wrap_angle
from lirs_wct.kernels import njit
from slam_baselines.linalg import moved_covariance
from slam_baselines.motion.calibration import LEVEL, Calibration, CalibrationConfig, Slope

STANDSTILL = 1e-3
"""Sum of meters and radians up to which an increment counts as standing."""


def yaw_rate(imu: Imu) -> float:
    """Return the rate of yaw, rad/s, in R = Rz Ry Rx from the body's rates."""
    _, y, z = imu.angular_velocity
    return (y * math.sin(imu.roll) + z * math.cos(imu.roll)) / max(math.cos(imu.pitch), 0.1)


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """A pose and its covariance.

    Attributes:
        pose: `T_map_base`.
        covariance: (3, 3) of x, y, yaw in the map frame.
    """

    pose: Pose2
    covariance: FloatArray


class MotionStep(NamedTuple):
    """Step by dead reckoning, independent of its start.

    Attributes:
        delta: `T_before_now`.
        shift: variance of the translation along each axis, square meters.
        turn: variance of the yaw, square radians.
    """

    delta: Pose2
    shift: float
    turn: float

    def after(self, before: PoseEstimate) -> PoseEstimate:
        """Return the expected estimate after the step."""
        pose = before.pose @ self.delta
        dx, dy = pose.x - before.pose.x, pose.y - before.pose.y
        return PoseEstimate(pose, moved_covariance(before.covariance, dx, dy, self.shift, self.turn))


@dataclass(frozen=True, kw_only=True)
class MotionConfig(Checked, of="the motion"):
    """Errors of the odometry as random walks over distance, turn and time.

    Variances add up, so that the uncertainty of a motion does not depend on the rate of the scans.

    Attributes:
        translation_per_meter: standard deviation after one meter, meters.
        translation_per_radian: after turning one radian, meters.
        slide_per_radian: after turning one radian on a slope, meters per radian of tilt.
        translation_per_second: after one second, meters.
        rotation_per_meter: after one meter, radians.
        rotation_per_radian: after turning one radian, radians.
        rotation_per_second: after one second, radians.
        gyro_per_second: of a gyro's yaw after one second, radians.
        blind_translation: after one second without odometry, meters.
        blind_rotation: after one second without odometry, radians.
    """

    translation_per_meter: float = limited(0.04, "(0, inf]")
    translation_per_radian: float = limited(0.1, "(0, inf]")
    slide_per_radian: float = limited(2.0, "(0, inf]")
    translation_per_second: float = limited(0.005, "(0, inf]")
    rotation_per_meter: float = limited(0.03, "(0, inf]")
    rotation_per_radian: float = limited(0.05, "(0, inf]")
    rotation_per_second: float = limited(0.005, "(0, inf]")
    gyro_per_second: float = limited(0.001, "(0, inf]")
    blind_translation: float = limited(0.5, "(0, inf]")
    blind_rotation: float = limited(0.5, "(0, inf]")

    def predict(
        self,
        before: PoseEstimate,
        delta: Pose2 | None,
        seconds: float,
        turned: float | None = None,
        tilt: float = 0.0,
    ) -> PoseEstimate:
        """Return the expected estimate after a step.

        Args:
            before: the estimate before the step.
            delta: `T_before_now` by odometry; without it the robot is expected to stay, with a large
                covariance.
            seconds: duration of the step.
            turned: change of yaw by the gyro, if there is one, radians. If gyro and odometry agree, the yaw
                has the gyro's variance; their disagreement raises it.
            tilt: of the robot, radians: wheels that skid in a turn slide downhill.
        """
        return self.step(delta, seconds, turned, tilt).after(before)

    def step(
        self, delta: Pose2 | None, seconds: float, turned: float | None = None, tilt: float = 0.0
    ) -> MotionStep:
        """Return a step with its variances; arguments as of predict."""
        seconds = max(seconds, 1e-3)
        if delta is None:
            delta = Pose2(yaw=turned or 0.0)
            shift, turn = self.blind_translation**2 * seconds, self.blind_rotation**2 * seconds
        else:
            shift, turn = self._variances(delta, seconds, tilt)
        if turned is not None:
            turn = min(turn, self.gyro_per_second**2 * seconds + wrap_angle(turned - delta.yaw) ** 2)
        return MotionStep(delta, shift, turn)

    def predict_all(
        self, before: PoseEstimate, steps: Sequence[tuple[Pose2, float]], seconds: float
    ) -> PoseEstimate:
        """Return the expected estimate after some steps whose yaw a gyro confirms.

        Args:
            before: the estimate before the first step.
            steps: of each `T_before_now`, and the tilt of the robot, radians.
            seconds: duration of one step.
        """
        seconds = max(seconds, 1e-3)
        gyro, rows = self.gyro_per_second**2 * seconds, []
        for delta, tilt in steps:
            shift, turn = self._variances(delta, seconds, tilt)
            rows.append((delta.x, delta.y, delta.yaw, shift, min(turn, gyro)))
        pose, covariance = propagate_steps(before.pose.as_array(), before.covariance, np.array(rows))
        return PoseEstimate(Pose2(*pose.tolist()), covariance)

    def _variances(self, delta: Pose2, seconds: float, tilt: float) -> tuple[float, float]:
        """Return the variances of an odometry step: translation along each axis, and yaw."""
        meters, radians = math.hypot(delta.x, delta.y), abs(delta.yaw)
        per_meter, per_radian, per_second, turn_per_meter, turn_per_radian, turn_per_second = self._squares
        shift = (
            per_meter * meters
            + (per_radian + (self.slide_per_radian * tilt) ** 2) * radians
            + per_second * seconds
        )
        return shift, turn_per_meter * meters + turn_per_radian * radians + turn_per_second * seconds

    @cached_property
    def _squares(self) -> tuple[float, ...]:
        """Variances of translation and rotation per meter, radian and second."""
        return (
            self.translation_per_meter**2,
            self.translation_per_radian**2,
            self.translation_per_second**2,
            self.rotation_per_meter**2,
            self.rotation_per_radian**2,
            self.rotation_per_second**2,
        )


@njit
def propagate_steps(pose: Any, covariance: Any, steps: Any) -> Any:
    """Return pose (3,) and covariance (3, 3) after steps.

    Args:
        pose: (3,) x, y, yaw before the first.
        covariance: (3, 3).
        steps: (n, 5) x, y, yaw of `T_before_now`, variance of the translation along each axis and of the yaw.
    """
    pose = pose.copy()
    for dx, dy, dyaw, shift, turn in steps:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        x, y, yaw = pose[0] + c * dx - s * dy, pose[1] + s * dx + c * dy, pose[2] + dyaw
        covariance = moved_covariance(covariance, x - pose[0], y - pose[1], shift, turn)
        # In (-pi, pi], as both of the sum's terms are.
        if yaw > math.pi:
            yaw -= math.tau
        elif yaw <= -math.pi:
            yaw += math.tau
        pose[0], pose[1], pose[2] = x, y, yaw
    return pose, covariance


class OdometryStep(NamedTuple):
    """Step by odometry, and the slope of the ground.

    Attributes:
        step: `T_before_now` by odometry.
        down: descent of the ground per meter ahead and to the left.
        tilt: of the robot, radians.
    """

    step: Pose2
    down: Slope
    tilt: float

    def correct(self, calibration: Calibration) -> Pose2:
        """Return the expected step by the calibration."""
        return calibration.correct(self.step, self.down)


class DeadReckoning:
    """Expected estimate at the next scan by absolute odometry and rates.

    Attributes:
        calibration: systematic odometry errors.
        increment: the last one; None without odometry.
        calibrated: whether steps are corrected by the calibration.
        learned: steps that the calibration has learned from.
    """

    def __init__(self, config: MotionConfig, calibration: CalibrationConfig | None = None) -> None:
        self.config = config
        self.calibration = Calibration(calibration or CalibrationConfig())
        self.increment: OdometryStep | None = None
        self.calibrated = True
        self.learned = 0
        self._odometry: Pose2 | None = None
        self._rate: float | None = None
        self._stamp: float | None = None

    def predict(
        self, last: PoseEstimate, odometry: Pose2 | None, imu: Imu | None, stamp: float
    ) -> PoseEstimate:
        """Return the expected estimate at `stamp`; the first call returns `last`.

        Args:
            last: the estimate at the last call.
            odometry: `T_odom_base` at `stamp`.
            imu: reading at `stamp`.
            stamp: seconds.
        """
        step = self.step(odometry, imu, stamp)
        return last if step is None else step.after(last)

    def step(self, odometry: Pose2 | None, imu: Imu | None, stamp: float) -> MotionStep | None:
        """Return the step since the last call, None at the first; arguments as of predict."""
        before, self._odometry = self._odometry, odometry
        rate, self._rate = self._rate, None if imu is None else yaw_rate(imu)
        then, self._stamp = self._stamp, stamp
        if before is None or odometry is None:
            self.increment = None
        else:
            self.increment = OdometryStep(_between(before, odometry), *_downhill(imu))
        if then is None:
            return None
        delta = None if self.increment is None else self._correct(self.increment)
        turned = None if rate is None or self._rate is None else (rate + self._rate) / 2 * (stamp - then)
        return self.config.step(delta, stamp - then, turned, self.increment.tilt if self.increment else 0.0)

    def _correct(self, increment: OdometryStep) -> Pose2:
        return increment.correct(self.calibration) if self.calibrated else increment.step

    def learn(self, before: Pose2, now: Pose2) -> None:
        """Calibrate by the last step, which truly led from `before` to `now` in the map."""
        # A standing robot gives no information, and must not make the calibration forget.
        if (
            self.increment is not None
            and abs(self.increment.step.x) + abs(self.increment.step.yaw) > STANDSTILL
        ):
            self.learned += 1
            self.calibration.learn(self.increment.step, _between(before, now), self.increment.down)


def _between(a: Pose2, b: Pose2) -> Pose2:
    """Return `T_ab` of two poses in one frame."""
    c, s, x, y = math.cos(a.yaw), math.sin(a.yaw), b.x - a.x, b.y - a.y
    return Pose2(c * x + s * y, c * y - s * x, wrap_angle(b.yaw - a.yaw))


def _downhill(imu: Imu | None) -> tuple[Slope, float]:
    """Return the ground's descent ahead and to the left, and the robot's tilt in radians."""
    if imu is None:
        return LEVEL, 0.0
    return (math.sin(imu.pitch), -math.sin(imu.roll)), math.hypot(imu.roll, imu.pitch)


def climb(dx: float, dy: float, up: FloatArray) -> float:
    """Return the rise of a step on an inclined plane, meters.

    A robot on wheels moves in the plane of its x and y axes, so that up . (dx, dy, rise) = 0.

    Args:
        dx: horizontal step along x of a level frame, meters.
        dy: along y.
        up: (3,) z axis of the robot in that frame, of any length; upward.
    """
    return float(-(up[0] * dx + up[1] * dy) / max(up[2], 0.1))


def spatial_odometry(odometry: Sequence[Pose2], readings: Sequence[Imu | None]) -> list[Pose3]:
    """Return poses in space by planar odometry and attitude.

    Position and yaw in the plane are the odometry's. Roll and pitch are those of the inertial readings, 0
    without one. The height adds up the climbs, with the mean attitude of a step's two ends.

    Args:
        odometry: `T_odom_base` in the plane.
        readings: inertial readings at the same stamps.
    """
    poses: list[Pose3] = []
    for planar, imu in zip(odometry, readings, strict=True):
        roll, pitch = (0.0, 0.0) if imu is None else (imu.roll, imu.pitch)
        pose = Pose3.from_rpy(planar.x, planar.y, 0.0, roll, pitch, planar.yaw)
        if poses:
            last = poses[-1]
            up = (last.rotation + pose.rotation)[:, 2]
            z = last.z + climb(pose.x - last.x, pose.y - last.y, up)
            pose = Pose3(pose.x, pose.y, z, *pose.quaternion.tolist())
        poses.append(pose)
    return poses
