"""Dead reckoning: expected pose and covariance by odometry and gyro."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import FloatArray, Imu, Pose2, Pose3, njit, wrap_angle

Slope = tuple[float, float]
"""Descent of the ground per meter ahead and per meter to the left."""
LEVEL: Slope = (0.0, 0.0)
UNTOLD = 1e-100
"""Information below which a step replaces none, since its square underflows."""


@dataclass(frozen=True, kw_only=True)
class CalibrationConfig(Checked):
    """Prior and noise of the odometry's correction, which set its rate of learning.

    Attributes:
        calibration_per_meter: Prior standard deviation of the correction per meter driven (m/m, rad/m).
        calibration_per_radian: Prior standard deviation per radian turned (m/rad, rad/rad).
        calibration_noise: Noise of the correction observed in one step, meters and radians.
        calibration_memory: Steps of one kind after which an observation of that kind counts 1/e.
        calibration_slide: Prior standard deviation of the slide, meters per radian and unit of slope.
        calibration_slide_noise: Noise of the slide observed in one step, meters.
    """

    calibration_per_meter: float = limited(0.05, "(0, inf]")
    calibration_per_radian: float = limited(0.05, "(0, inf]")
    calibration_noise: float = limited(0.02, "(0, inf]")
    calibration_memory: float = limited(500.0, "(0, inf]")
    calibration_slide: float = limited(2.0, "(0, inf]")
    calibration_slide_noise: float = limited(0.007, "(0, inf]")


class Calibration:
    """Correction of odometry's systematic errors, learned from the poses that scan matching confirms.

    Wheels of unequal size, a wrong track, or a displaced laser cause the same error in every step. Their
    correction is linear in the distance traveled and the angle turned; recursive least squares estimates it.
    Forgetting is directional (Cao and Schwartz 2000, "A directional forgetting algorithm based on the
    decomposition of the information matrix", Automatica 36, Eqs. 21-23): a step replaces older ones of its
    kind only, so that minutes of circles leave the knowledge about straight steps as it is.

    Wheels that skid in a turn have no friction left: on a slope the robot also slides downhill, by a distance
    per radian turned and unit of slope. That is one more gain.

    Attributes:
        gain: correction of x, y, yaw per meter ahead and per radian: xx, xt, yx, yt, tx, tt.
        slide: meters downhill per radian turned, either way, and unit of slope.
    """

    def __init__(self, config: CalibrationConfig) -> None:
        self.gain = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        self.slide = 0.0
        c = config
        self._prior = 1 / c.calibration_per_meter**2, 1 / c.calibration_per_radian**2
        self._information = 0.0, 0.0, 0.0
        self._noise = c.calibration_noise**2
        self._keep = math.exp(-1 / c.calibration_memory)
        self._slide_start = self._slide_variance = c.calibration_slide**2
        self._slide_noise = c.calibration_slide_noise**2

    @property
    def covariance(self) -> tuple[float, float, float]:
        """Covariance of each row of the gain: per meter^2, per meter and radian, per radian^2."""
        p, q, r = self._information
        p, r = p + self._prior[0], r + self._prior[1]
        determinant = p * r - q * q
        return r / determinant, -q / determinant, p / determinant

    def correct(self, step: Pose2, down: Slope = LEVEL) -> Pose2:
        """Return the expected step `T_before_now` for an odometry `step` on ground of slope `down`."""
        xx, xt, yx, yt, tx, tt = self.gain
        d, a = step.x, step.yaw
        slide = self.slide * abs(a)
        return Pose2(
            d + xx * d + xt * a + slide * down[0],
            step.y + yx * d + yt * a + slide * down[1],
            math.remainder(a + tx * d + tt * a, math.tau),
        )

    def learn(self, step: Pose2, true: Pose2, down: Slope = LEVEL) -> None:
        """Learn from a true step, its odometry `step` and the slope `down` of the ground."""
        d, a = step.x, step.yaw
        c = self.correct(step, down)
        x, y, t = true.x - c.x, true.y - c.y, math.remainder(true.yaw - c.yaw, math.tau)
        self._observe(d, a)
        p, q, r = self.covariance
        u, v = (p * d + q * a) / self._noise, (q * d + r * a) / self._noise
        xx, xt, yx, yt, tx, tt = self.gain
        self.gain = xx + x * u, xt + x * v, yx + y * u, yt + y * v, tx + t * u, tt + t * v
        # The slide learns from the error that a slide of (u, v) per gain left.
        u, v = abs(a) * down[0], abs(a) * down[1]
        variance, total = self._slide_variance, u * u + v * v
        scale = variance / (self._slide_noise + variance * total)
        self.slide += scale * (u * x + v * y)
        self._slide_variance = min((variance - scale * total * variance) / self._keep, self._slide_start)

    def _observe(self, d: float, a: float) -> None:
        """Add a step's information in place of older information about such steps.

        The prior knowledge is never forgotten: it bounds the covariance from above.
        """
        p, q, r = self._information
        u, v = p * d + q * a, q * d + r * a
        known = u * d + v * a
        forget = (1 - self._keep) / known if known > UNTOLD else 0.0
        self._information = (
            p - forget * u * u + d * d / self._noise,
            q - forget * u * v + d * a / self._noise,
            r - forget * v * v + a * a / self._noise,
        )


STANDSTILL = 1e-3
"""Sum of meters and radians up to which an increment counts as standing."""


def yaw_rate(imu: Imu) -> float:
    """Return the rate of yaw in R = Rz Ry Rx, rad/s."""
    _, y, z = imu.angular_velocity
    return (y * math.sin(imu.roll) + z * math.cos(imu.roll)) / max(math.cos(imu.pitch), 0.1)


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """Pose `T_map_base` and its covariance (3, 3) of x, y, yaw in the map frame."""

    pose: Pose2
    covariance: FloatArray


class MotionStep(NamedTuple):
    """Step `T_before_now` by dead reckoning, independent of its start.

    It has the variances of the translation along each axis, square meters, and of the turn, square radians.
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
class MotionConfig(Checked):
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
        gyro_per_second: Standard deviation of a gyro's yaw after one second, radians.
        blind_translation: after one second without odometry, meters.
        blind_rotation: after one second without odometry, radians.
    """

    translation_per_meter: float = limited(0.04, "(0, inf]")
    translation_per_radian: float = limited(0.1, "(0, inf]")
    slide_per_radian: float = limited(1.0, "(0, inf]")
    translation_per_second: float = limited(0.005, "(0, inf]")
    rotation_per_meter: float = limited(0.03, "(0, inf]")
    rotation_per_radian: float = limited(0.05, "(0, inf]")
    rotation_per_second: float = limited(0.005, "(0, inf]")
    gyro_per_second: float = limited(0.001, "(0, inf]")
    blind_translation: float = limited(0.5, "(0, inf]")
    blind_rotation: float = limited(0.5, "(0, inf]")

    def step(
        self, delta: Pose2 | None, seconds: float, turned: float | None = None, tilt: float = 0.0
    ) -> MotionStep:
        """Return a step with its variances.

        Args:
            delta: `T_before_now` by odometry; without it the robot is expected to stay, with a large
                covariance.
            seconds: Duration of the step.
            turned: Change of yaw by the gyro, if there is one, radians. If gyro and odometry agree, the yaw
                has the gyro's variance; their disagreement raises it.
            tilt: Angle of the robot's z to gravity, radians: wheels that skid in a turn slide downhill.
        """
        seconds = max(seconds, 1e-3)
        if delta is None:
            delta = Pose2(yaw=turned or 0.0)
            shift, turn = self.blind_translation**2 * seconds, self.blind_rotation**2 * seconds
        else:
            shift, turn = self._variances(delta, seconds, tilt)
        if turned is not None:
            off = math.remainder(turned - delta.yaw, math.tau)
            turn = min(turn, self.gyro_per_second**2 * seconds + off**2)
        return MotionStep(delta, shift, turn)

    def predict_all(
        self, before: PoseEstimate, steps: Sequence[tuple[Pose2, float]], seconds: float
    ) -> PoseEstimate:
        """Return the expected estimate after steps of equal duration whose yaw a gyro confirms.

        Each step is a `T_before_now` and the robot's tilt, radians.
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
    """Return pose (3,) and covariance (3, 3) after steps (n, 5).

    A step is x, y, yaw of `T_before_now`, and the variances of the translation along each axis and of the
    yaw.
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


@njit
def moved_covariance(P: Any, dx: float, dy: float, shift: float, turn: float) -> Any:
    """Return the covariance of x, y, yaw after a step in the map frame.

    That is G P G' + Q with G = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]] and the step's own variances
    Q = diag(shift, shift, turn).
    """
    a, b, c = P[0, 2], P[1, 2], P[2, 2]
    R = np.empty((3, 3))
    R[0, 0] = P[0, 0] - 2 * dy * a + dy * dy * c + shift
    R[1, 1] = P[1, 1] + 2 * dx * b + dx * dx * c + shift
    R[0, 1] = R[1, 0] = P[0, 1] + dx * a - dy * b - dx * dy * c
    R[0, 2] = R[2, 0] = a - dy * c
    R[1, 2] = R[2, 1] = b + dx * c
    R[2, 2] = c + turn
    return R


GYRO_BIAS = math.radians(0.02)
"""Standard deviation of the constant error of a gyro that was zeroed at rest, rad/s."""
SLIDE = 1.0
"""Standard deviation of the slide downhill per radian turned and unit of slope, meters: about the distance of
a wheel from the robot's center over the friction."""
ANCHOR_REACH = 0.5
"""Distance up to which a scan is matched to what a keyframe drew, in ranges of the keyframe's view."""


class DriftCovariance:
    """Covariance of `T_map_base` with the errors of the map itself.

    A match places a scan in what an earlier keyframe drew, and so with that keyframe's error. Dead reckoning
    adds its variances; a match removes only what exceeds the covariance of the earliest keyframe in view, its
    anchor, and of the place of a wall in the map.

    Attributes:
        covariance: (3, 3) of x, y, yaw in the map frame, meters and radians.
        first: Index of the first keyframe in the map that scans are matched to.
    """

    def __init__(self, deviation: float) -> None:
        """Start at the origin of a map that places walls with a standard deviation, meters."""
        self.covariance: FloatArray = np.zeros((3, 3))
        self._deviation, self._blind, self._slid, self.first = deviation, 0.0, np.zeros(2), 0
        self._keyframes = np.empty((0, 3))  # x, y, range of the view
        self._covariances: list[FloatArray] = []

    def move(
        self, before: Pose2, pose: Pose2, noise: FloatArray, seconds: float, slope: Slope = LEVEL
    ) -> None:
        """Add a step's noise (3, 3) in the map frame, and its systematic errors.

        These are a gyro's bias and the slide of turning wheels on ground of a slope in the base frame.
        """
        P = moved_covariance(self.covariance, pose.x - before.x, pose.y - before.y, 0.0, 0.0) + noise
        P[2, 2] += GYRO_BIAS**2 * seconds * (2 * self._blind + seconds)
        turn, c, s = abs(wrap_angle(pose.yaw - before.yaw)), math.cos(pose.yaw), math.sin(pose.yaw)
        slide = turn * np.array((c * slope[0] - s * slope[1], s * slope[0] + c * slope[1]))
        if square := float(slide @ slide):
            growth = 1 + 2 * max(float(slide @ self._slid), 0.0) / square
            P[:2, :2] += SLIDE**2 * growth * np.outer(slide, slide)
        self.covariance, self._blind, self._slid = P, self._blind + seconds, self._slid + slide

    def match(self, pose: Pose2, prior: FloatArray, matched: FloatArray, hits: FloatArray) -> None:
        """Remove the error that a match to `pose` corrects.

        The covariances (3, 3) before and after it are relative to the map. Hits (n, 2 or more) are ends of
        beams in the base frame, meters.
        """
        if len(self._covariances) <= self.first or not len(hits):
            return
        x, y, view = self._keyframes[self.first :].T
        near = np.hypot(x - pose.x, y - pose.y) <= ANCHOR_REACH * view
        anchor = self.first + int(near.argmax()) if near.any() else -1
        x, y, _ = self._keyframes[anchor]
        floor = moved_covariance(self._covariances[anchor], pose.x - x, pose.y - y, 0.0, 0.0)
        floor += self._deviation**2 * np.diag((1.0, 1.0, view_range(hits) ** -2))
        self.covariance, left = above_floor(self.covariance, floor, prior, matched)
        self._slid, self._blind = self._slid * math.sqrt(left[0]), self._blind * math.sqrt(left[1])

    def add_keyframe(self, pose: Pose2, hits: FloatArray) -> None:
        """Note a scan that enters the map with the present covariance."""
        self._keyframes = np.vstack((self._keyframes, (pose.x, pose.y, view_range(hits))))
        self._covariances.append(self.covariance)


def view_range(hits: FloatArray) -> float:
    """Return the rms distance of hits (n, 2 or more), at least .1 m."""
    return max(float(np.linalg.norm(hits[:, :2])) / math.sqrt(max(len(hits), 1)), 0.1)


@njit
def above_floor(P: Any, floor: Any, prior: Any, matched: Any) -> Any:
    """Return a covariance after a match; shares (2,) of its excess left in position and yaw.

    The excess of P over the floor falls by the information that took `prior` to `matched`, all (3, 3).
    """
    values, turn = np.linalg.eigh(floor)
    whole, inverse = turn * np.sqrt(values), turn / np.sqrt(values)
    shares, turn = np.linalg.eigh(inverse.T @ P @ inverse)
    axes = whole @ turn  # floor = axes axes', P = axes diag(shares) axes'
    root = np.sqrt(np.maximum(shares - 1, 0.0))
    scaled = axes * root
    # Negative where a search gave up the prior, and by rounding.
    values, turn = np.linalg.eigh(scaled.T @ (np.linalg.inv(matched) - np.linalg.inv(prior)) @ scaled)
    reduced = scaled @ turn
    found = (axes * np.minimum(shares, 1.0)) @ axes.T + (reduced / (1 + np.maximum(values, 0.0))) @ reduced.T
    excess, left = np.full(2, 1e-300), np.full(2, 1e-300)
    for i in range(3):
        for j in range(3):
            square = reduced[i, j] ** 2
            excess[i // 2] += square
            left[i // 2] += square / (1 + max(values[j], 0.0))
    return (found + found.T) / 2, left / excess


class OdometryStep(NamedTuple):
    """Step `T_before_now` by odometry, descent of the ground, and tilt, radians."""

    step: Pose2
    down: Slope
    tilt: float


class DeadReckoning:
    """Expected estimate at the next scan by absolute odometry and rates.

    Attributes:
        increment: Last step by odometry; None without odometry.
        calibrated: Whether steps are corrected by the calibration.
        learned: Number of steps that the calibration has learned from.
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
        """Return the expected estimate at `stamp`, given that at the last call."""
        step = self.step(odometry, imu, stamp)
        return last if step is None else step.after(last)

    def step(self, odometry: Pose2 | None, imu: Imu | None, stamp: float) -> MotionStep | None:
        """Return the step since the last call, None at the first."""
        before, self._odometry = self._odometry, odometry
        rate, self._rate = self._rate, None if imu is None else yaw_rate(imu)
        then, self._stamp = self._stamp, stamp
        self.increment, delta, tilt = None, None, 0.0
        if before is not None and odometry is not None:
            tilt = 0.0 if imu is None else math.hypot(imu.roll, imu.pitch)
            down = LEVEL if imu is None else (math.sin(imu.pitch), -math.sin(imu.roll))
            delta = _between(before, odometry)
            self.increment = OdometryStep(delta, down, tilt)
            if self.calibrated:
                delta = self.calibration.correct(delta, down)
        if then is None:
            return None
        turned = None if rate is None or self._rate is None else (rate + self._rate) / 2 * (stamp - then)
        return self.config.step(delta, stamp - then, turned, tilt)

    def learn(self, before: Pose2, now: Pose2) -> None:
        """Calibrate by the last step, which truly led from `before` to `now` in the map."""
        # A standing robot gives no information, and must not make the calibration forget.
        last = self.increment
        if last is not None and abs(last.step.x) + abs(last.step.yaw) > STANDSTILL:
            self.learned += 1
            self.calibration.learn(last.step, _between(before, now), last.down)


def _between(a: Pose2, b: Pose2) -> Pose2:
    """Return `T_ab` of two poses in one frame."""
    c, s, x, y = math.cos(a.yaw), math.sin(a.yaw), b.x - a.x, b.y - a.y
    return Pose2(c * x + s * y, c * y - s * x, math.remainder(b.yaw - a.yaw, math.tau))


def climb(dx: float, dy: float, up: FloatArray) -> float:
    """Return the rise of a horizontal step (dx, dy) on an inclined plane, meters.

    A robot on wheels moves in the plane of its x and y axes, so that up . (dx, dy, rise) = 0 with `up` (3,)
    its z axis, of any length, in the step's level frame.
    """
    return float(-(up[0] * dx + up[1] * dy) / max(up[2], 0.1))


def spatial_odometry(odometry: Sequence[Pose2], readings: Sequence[Imu | None]) -> list[Pose3]:
    """Return poses in space by planar odometry and attitude.

    Position and yaw in the plane are those of the odometry `T_odom_base`. Roll and pitch are those of the
    inertial readings at the same stamps, 0 without one. The height adds up the climbs, with the mean attitude
    of a step's two ends.
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
