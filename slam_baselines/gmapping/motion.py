"""Motion model: motion since the last processed scan, gyro's bias, particles' poses by both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import FloatArray, Imu, Pose2
from slam_baselines.dead_reckoning import GYRO_BIAS, DeadReckoning, MotionConfig, PoseEstimate, yaw_rate
from slam_baselines.registration import solve3

ALIKE = np.array((1.0, 0.0))
"""Observation model: the disagreement is observed, the bias is not."""


@dataclass(frozen=True, kw_only=True)
class GyroBiasConfig(Checked):
    """Standard deviations of a gyro and of the registered headings.

    Attributes:
        gyro_bias_prior: Prior standard deviation of the bias, rad/s: the zero-rate offset of the data sheet.
            The default is a small MEMS unit's that was zeroed while the robot stood, 0.02 deg/s.
        gyro_bias_drift: Random walk of the bias itself after one second, rad/s.
        heading_walk: Random walk of the disagreement of map and gyro after one second, radians.
        heading_error: Standard deviation of the heading at which a scan is registered, radians.
        gyro_bias_gate: Standard deviations from the expected disagreement beyond which one is not learned
            from.
    """

    gyro_bias_prior: float = limited(GYRO_BIAS, "(0, inf]")
    gyro_bias_drift: float = limited(math.radians(0.0002), "(0, inf]")
    heading_walk: float = limited(math.radians(0.1), "(0, inf]")
    heading_error: float = limited(math.radians(0.3), "(0, inf]")
    gyro_bias_gate: float = limited(3.0, "(0, inf]")


@dataclass(frozen=True)
class GyroBias:
    """Bias of a gyro, estimated from its disagreement with registered headings.

    A Kalman filter of two states: the bias, rad/s, and the disagreement between map and gyro heading by all
    other causes, radians. The second is a random walk (of the gyro, and of the growing map). Such a walk also
    shows trends over a few meters, which so do not count as a bias.
    """

    config: GyroBiasConfig
    state: FloatArray
    covariance: FloatArray
    observed: float = 0.0

    @staticmethod
    def unknown(config: GyroBiasConfig) -> GyroBias:
        """Return the state at the start, where map and gyro agree by definition."""
        variances = config.heading_error**2, config.gyro_bias_prior**2
        return GyroBias(config, np.zeros(2), np.diag(variances))

    @property
    def value(self) -> float:
        """The bias, rad/s."""
        return float(self.state[1])

    @property
    def deviation(self) -> float:
        """Its standard deviation, rad/s."""
        return math.sqrt(float(self.covariance[1, 1]))

    def learned(self, disagreement: float, seconds: float) -> GyroBias:
        """Return the state after a step of some seconds.

        The disagreement is the turn of the map's heading minus that of the raw gyro, radians.
        """
        c = self.config
        F = np.array(((1.0, -seconds), (0.0, 1.0)))
        state = F @ self.state
        covariance = F @ self.covariance @ F.T + np.diag((c.heading_walk**2, c.gyro_bias_drift**2)) * seconds
        observed = self.observed + disagreement
        innovation, variance = observed - state[0], covariance[0, 0] + c.heading_error**2
        if innovation**2 > c.gyro_bias_gate**2 * variance:
            # The map was turned, as by another particle: the walk goes on from there.
            return replace(self, state=state + ALIKE * innovation, covariance=covariance, observed=observed)
        gain = covariance[:, 0] / variance
        keep = np.eye(2) - np.outer(gain, ALIKE)
        # Joseph's form stays symmetric and positive definite.
        covariance = keep @ covariance @ keep.T + np.outer(gain, gain) * c.heading_error**2
        return replace(self, state=state + gain * innovation, covariance=covariance, observed=observed)


GYRO = 5e-4
"""Random walk of a gyro's yaw without its bias: standard deviation after one second, radians."""

POSITION, HEADING = 0.05, math.radians(0.5)
"""Standard deviations of a registered scan's pose, meters and radians."""
REGISTERED = np.diag((POSITION**2, POSITION**2, HEADING**2))
"""Covariance of a registered scan's pose."""
STILL = 1e-9
"""Meters and radians up to which a step counts as standing."""


class MotionIncrement:
    """Motion of the base since `begin`.

    Attributes:
        pose: `T_begin_now`, corrected.
        newest: (3, 3) covariance of the last addition.
        reckoned: Motion since `begin` by raw odometry and gyro, with the sum of the covariances.
        bias: Bias of the gyro, rad/s; subtracted in `pose`.
        seconds: Time spent moving.
        distance: Traveled, meters.
        turn: Radians turned, either way.
    """

    def __init__(self, motion: MotionConfig) -> None:
        self._reckoning = DeadReckoning(motion)
        self._reading: tuple[float, float] | None = None
        self.bias = 0.0
        self.begin()

    def begin(self) -> None:
        """Start a new increment here."""
        self.pose = Pose2()
        self.newest: FloatArray = np.zeros((3, 3))
        self.reckoned = PoseEstimate(Pose2(), self.newest)
        self.distance = self.turn = self.seconds = self._disagreement = 0.0

    def add_odometry(self, odometry: Pose2 | None, imu: Imu | None, stamp: float) -> Pose2:
        """Add the motion by odometry and gyro up to a stamp; return it, `T_before_now`."""
        exact = PoseEstimate(self.pose, np.zeros((3, 3)))
        now = self._reckoning.predict(exact, odometry, imu, stamp)
        delta = self.pose.inverse() @ now.pose
        before, self._reading = self._reading, None if imu is None else (stamp, yaw_rate(imu))
        self.newest, seconds = now.covariance, 0.0
        self.reckoned = PoseEstimate(self.reckoned.pose @ delta, self.reckoned.covariance + now.covariance)
        # While it stands the wheels hold the heading, whatever the gyro says.
        moving = max(abs(delta.x), abs(delta.y), abs(delta.yaw)) > STILL
        if moving and before is not None and self._reading is not None:
            seconds = stamp - before[0]
            self._compare(delta.yaw, (before[1] + self._reading[1]) / 2, seconds)
        delta = remove_bias(delta, self.bias, seconds)
        self.pose = self.pose @ delta
        self.distance += math.hypot(delta.x, delta.y)
        self.turn += abs(delta.yaw)
        return delta

    def distance_from(self, pose: Pose2) -> float:
        """Return the Mahalanobis distance of `T_begin_now` from dead reckoning without bias.

        The poses at which the step begins and ends are those of registered scans, with their own errors.
        """
        off = remove_bias(self.reckoned.pose, self.bias, self.seconds).inverse() @ pose
        d = np.array((off.x, off.y, off.yaw))
        return math.sqrt(float(d @ solve3(self.reckoned.covariance + REGISTERED, d)))

    def _compare(self, turn: float, rate: float, seconds: float) -> None:
        """Set the heading's variance by the gyro's noise and its disagreement with the odometry.

        The noise of single readings cancels over the distance.
        """
        self.seconds += seconds
        self._disagreement += turn - rate * seconds
        variance = GYRO**2 * self.seconds + self._disagreement**2
        whole, newest = self.reckoned.covariance, self.newest
        newest[2, 2], whole[2, 2] = variance * seconds / self.seconds, variance


def remove_bias(step: Pose2, bias: float, seconds: float) -> Pose2:
    """Return a step without the turn by a gyro's bias (rad/s)."""
    half = Pose2(yaw=-bias * seconds / 2)
    return half @ step @ half


class PoseDistributions(NamedTuple):
    """Distributions of the particles' poses (particles, 3) by odometry.

    Their covariances (particles, 3, 3) are in the map frame.
    """

    poses: FloatArray
    covariances: FloatArray


def propagate(poses: FloatArray, step: Pose2, covariance: FloatArray) -> PoseDistributions:
    """Return the distributions of particles (n, 3) after a step `T_before_now` common to all.

    The step's covariance (3, 3) is in the frame before it.
    """
    c, s, o = np.cos(poses[:, 2]), np.sin(poses[:, 2]), np.zeros(len(poses))
    R = np.stack((c, -s, o, s, c, o, o, o, o + 1), axis=-1).reshape(-1, 3, 3)
    return PoseDistributions(poses + R @ step.as_array(), R @ covariance @ R.transpose(0, 2, 1))
