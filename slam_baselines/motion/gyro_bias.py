"""Bias of a gyro, estimated from its disagreement with registered headings.

A Kalman filter of two states: the bias, and the disagreement between map and gyro heading by all other
causes. The second is a random walk (of the gyro, and of the growing map). Such a walk also shows trends over
a few meters, which so do not count as a bias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.checks import Checked, limited

ALIKE = np.array((1.0, 0.0))
"""Observation model: the disagreement is observed, the bias is not."""


@dataclass(frozen=True, kw_only=True)
class GyroBiasConfig(Checked, of="the gyro's bias"):
    """Standard deviations of a gyro and of the registered headings.

    Attributes:
        prior: of the bias before anything is known, rad/s: the zero-rate offset of the data sheet. The
            default is a small MEMS unit's that was zeroed while the robot stood, 0.02 deg/s.
        drift: of the bias's own random walk after one second, rad/s.
        walk: of the disagreement's random walk after one second, radians.
        heading: at which a scan is registered, radians.
        gate: standard deviations from the expected disagreement beyond which one is not learned from.
    """

    prior: float = limited(math.radians(0.02), "(0, inf]")
    drift: float = limited(math.radians(0.0002), "(0, inf]")
    walk: float = limited(math.radians(0.1), "(0, inf]")
    heading: float = limited(math.radians(0.3), "(0, inf]")
    gate: float = limited(3.0, "(0, inf]")


@dataclass(frozen=True)
class GyroBias:
    """State of the bias filter.

    Attributes:
        config: parameters of the filter.
        state: (2,) the disagreement between map and gyro in radians, and the bias in rad/s.
        covariance: (2, 2) of it.
        observed: disagreement of the last registered heading, radians.
    """

    config: GyroBiasConfig
    state: FloatArray
    covariance: FloatArray
    observed: float = 0.0

    @staticmethod
    def unknown(config: GyroBiasConfig) -> GyroBias:
        """Return the state at the start, where map and gyro agree by definition."""
        return GyroBias(config, np.zeros(2), np.diag((config.heading**2, config.prior**2)))

    @property
    def value(self) -> float:
        """The bias, rad/s."""
        return float(self.state[1])

    @property
    def deviation(self) -> float:
        """Its standard deviation, rad/s."""
        return math.sqrt(float(self.covariance[1, 1]))

    def learned(self, disagreement: float, seconds: float) -> GyroBias:
        """Return the state after a step.

        Args:
            disagreement: turn of the map's heading minus that of the raw gyro, radians.
            seconds: duration of the step.
        """
        c = self.config
        F = np.array(((1.0, -seconds), (0.0, 1.0)))
        state = F @ self.state
        covariance = F @ self.covariance @ F.T + np.diag((c.walk**2, c.drift**2)) * seconds
        observed = self.observed + disagreement
        innovation, variance = observed - state[0], covariance[0, 0] + c.heading**2
        if innovation**2 > c.gate**2 * variance:
            # The map was turned, as by another particle: the walk goes on from there.
            return replace(self, state=state + ALIKE * innovation, covariance=covariance, observed=observed)
        gain = covariance[:, 0] / variance
        keep = np.eye(2) - np.outer(gain, ALIKE)
        # Joseph's form stays symmetric and positive definite.
        covariance = keep @ covariance @ keep.T + np.outer(gain, gain) * c.heading**2
        return replace(self, state=state + gain * innovation, covariance=covariance, observed=observed)
