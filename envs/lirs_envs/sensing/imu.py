"""The inertial unit: attitude, rates and specific force of the base, with noise and slow bias.

Figures of a small MEMS unit that was zeroed while the robot stood still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import Vector3
from lirs_wct.field_validators import require_above, require_at_least
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import Imu

RATE_BLOCK = 256
"""Readings of the gyro whose noise is drawn at once."""


@dataclass(frozen=True, kw_only=True)
class ImuConfig:
    """Noise of an inertial unit; standard deviations.

    Attributes:
        attitude_sigma: white noise of roll and pitch in each reading, radians.
        attitude_bias: slowly varying error of roll and pitch, radians.
        attitude_time: correlation time of `attitude_bias`, seconds (first-order Gauss-Markov process).
        rate_sigma: white noise of each rate in each update, rad/s.
        rate_bias: constant error of each rate, drawn at a reset, rad/s.
        acceleration_sigma: white noise of each acceleration in each reading, m/s^2.
        acceleration_bias: constant error of each acceleration, drawn at a reset, m/s^2.

    Raises:
        ConfigError: a value is negative or not finite, or `attitude_time` is 0.
    """

    attitude_sigma: float = math.radians(0.1)
    attitude_bias: float = math.radians(0.1)
    attitude_time: float = 10.0
    rate_sigma: float = math.radians(0.1)
    rate_bias: float = math.radians(0.02)
    acceleration_sigma: float = 0.05
    acceleration_bias: float = 0.02

    def __post_init__(self) -> None:
        require_above(self, 0, "attitude_time", of="the IMU", unit="s", finite=True)
        biases = ("attitude_bias", "rate_bias", "acceleration_bias")
        sigmas = ("attitude_sigma", "rate_sigma", "acceleration_sigma")
        require_at_least(self, 0, *biases, *sigmas, of="the IMU", finite=True)


class ImuSensor:
    """Turns true motion into readings. Its biases are drawn when it is made."""

    def __init__(self, config: ImuConfig, rng: np.random.Generator) -> None:
        self.config = config
        self._rng = rng
        bias = rng.standard_normal(8)
        self._rate_bias = bias[:3] * config.rate_bias
        self._acceleration_bias = (bias[3:6] * config.acceleration_bias).tolist()
        self._roll_bias, self._pitch_bias = (bias[6:] * config.attitude_bias).tolist()
        self._rate_errors: list[list[float]] = []

    def rates(self, true_rates: Vector3) -> Vector3:
        """Return the measured rates about x, y, z of the base, rad/s."""
        if not self._rate_errors:
            # Drawn in blocks: one small array a reading would cost more than the rest of the reading.
            noise = self._rng.standard_normal((RATE_BLOCK, 3))
            self._rate_errors = (self._rate_bias + self.config.rate_sigma * noise).tolist()
        x, y, z = self._rate_errors.pop()
        return true_rates[0] + x, true_rates[1] + y, true_rates[2] + z

    def read(
        self, T_world_base: Pose3, rates: Vector3, specific_force: Vector3, stamp: float, dt: float
    ) -> Imu:
        """Return a reading.

        Args:
            T_world_base: true pose of the base.
            rates: as `rates` returned them, rad/s.
            specific_force: true, along x, y, z of the base, m/s^2.
            stamp: seconds.
            dt: seconds since the last reading.
        """
        config = self.config
        keep = math.exp(-dt / config.attitude_time)
        fresh = math.sqrt(1 - keep * keep) * config.attitude_bias
        # Plain numbers: seven of them in an array cost more than the reading.
        n = self._rng.standard_normal(7).tolist()
        self._roll_bias = keep * self._roll_bias + fresh * n[0]
        self._pitch_bias = keep * self._pitch_bias + fresh * n[1]
        white, (x, y, z) = config.acceleration_sigma, self._acceleration_bias
        return Imu(
            roll=T_world_base.roll + (self._roll_bias + config.attitude_sigma * n[2]),
            pitch=T_world_base.pitch + (self._pitch_bias + config.attitude_sigma * n[3]),
            angular_velocity=rates,
            linear_acceleration=(
                specific_force[0] + (x + white * n[4]),
                specific_force[1] + (y + white * n[5]),
                specific_force[2] + (z + white * n[6]),
            ),
            stamp=stamp,
        )
