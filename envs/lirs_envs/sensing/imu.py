"""Inertial unit: attitude, rates and specific force, with noise and bias.

Figures of a small MEMS unit that was zeroed while the robot stood still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray, Vector3
from lirs_wct.field_validators import require_above, require_at_least
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import Imu
from lirs_wct.kernels import njit

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


class ImuParameters(NamedTuple):
    """Standard deviations of an `ImuConfig` as the kernel reads them; `attitude_time` in seconds."""

    attitude_sigma: float
    attitude_bias: float
    attitude_time: float
    acceleration_sigma: float


class ImuSensors:
    """N inertial units, each with its own biases and random stream.

    They turn true motion into readings.

    Attributes:
        rate_bias: (N, 3) constant errors of the rates, rad/s.
        rate_errors: (N, RATE_BLOCK, 3) errors of the coming gyro readings, the last row first, rad/s.
        rates_left: (N,) rows of them that are not used up.
        bias: (N, 5) slowly varying errors of roll and pitch, radians, constant ones of the acceleration.
        normals: (N, 7) numbers for the next reading.
    """

    def __init__(self, config: ImuConfig, count: int) -> None:
        self.config = config
        c = config
        self.parameters = ImuParameters(
            *map(float, (c.attitude_sigma, c.attitude_bias, c.attitude_time, c.acceleration_sigma))
        )
        self._rngs = [np.random.default_rng(0) for _ in range(count)]
        self.rate_bias = np.zeros((count, 3))
        self.bias = np.zeros((count, 5))
        self.rate_errors = np.zeros((count, RATE_BLOCK, 3))
        self.rates_left = np.zeros(count, np.int64)
        self.normals = np.zeros((count, 7))

    def begin(self, i: int, rng: np.random.Generator) -> None:
        """Draw new biases of unit `i`; `rng` is its random stream from now on."""
        config, self._rngs[i] = self.config, rng
        bias = rng.standard_normal(8)
        self.rate_bias[i] = bias[:3] * config.rate_bias
        self.bias[i, :2], self.bias[i, 2:] = (
            bias[6:] * config.attitude_bias,
            bias[3:6] * config.acceleration_bias,
        )
        self.rates_left[i] = 0

    def draw_rate_errors(self) -> None:
        """Draw a new block of errors where one is used up. Single draws would cost more than the reading."""
        for i in np.flatnonzero(self.rates_left == 0).tolist():
            noise = self._rngs[i].standard_normal((RATE_BLOCK, 3))
            self.rate_errors[i] = self.rate_bias[i] + self.config.rate_sigma * noise
            self.rates_left[i] = RATE_BLOCK

    def draw_reading(self, i: int) -> None:
        """Draw the numbers for the next reading of unit `i`."""
        self._rngs[i].standard_normal(out=self.normals[i])


class ImuSensor:
    """One inertial unit. Its biases are drawn when it is made.

    Attributes:
        units: the same as a group of one.
    """

    def __init__(self, config: ImuConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.units = ImuSensors(config, 1)
        self.units.begin(0, rng)

    @property
    def rate_bias(self) -> FloatArray:
        """(3,) constant error of the rates, rad/s."""
        bias: FloatArray = self.units.rate_bias[0]
        return bias

    def rates(self, true_rates: Vector3) -> Vector3:
        """Return the measured rates about x, y, z of the base, rad/s."""
        units = self.units
        if units.rates_left[0] == 0:
            units.draw_rate_errors()
        x, y, z = next_rates(units.rate_errors[0], units.rates_left, true_rates)
        return x, y, z

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
        units = self.units
        units.draw_reading(0)
        attitude = (T_world_base.roll, T_world_base.pitch)
        roll, pitch, x, y, z = read_imu(
            units.bias[0], units.normals[0], attitude, specific_force, dt, units.parameters
        )
        return Imu(roll, pitch, rates, (x, y, z), stamp)


@njit(cache=True, nogil=True)
def next_rates(errors: FloatArray, left: IntArray, true: Vector3) -> Vector3:
    """Return the measured rates about x, y, z, rad/s.

    The next row of errors is used, and `left` (1,) is decremented.
    """
    left[0] -= 1
    row = left[0]
    return true[0] + errors[row, 0], true[1] + errors[row, 1], true[2] + errors[row, 2]


@njit(cache=True, nogil=True)
def read_imu(
    bias: FloatArray,
    normal: FloatArray,
    attitude: tuple[float, float],
    force: Vector3,
    dt: float,
    parameters: ImuParameters,
) -> tuple[float, float, float, float, float]:
    """Return measured roll, pitch and specific force; `bias` (5,) advances by `dt` seconds."""
    p = parameters
    keep = math.exp(-dt / p.attitude_time)
    fresh = math.sqrt(1 - keep * keep) * p.attitude_bias
    bias[0] = keep * bias[0] + fresh * normal[0]
    bias[1] = keep * bias[1] + fresh * normal[1]
    return (
        attitude[0] + (bias[0] + p.attitude_sigma * normal[2]),
        attitude[1] + (bias[1] + p.attitude_sigma * normal[3]),
        force[0] + (bias[2] + p.acceleration_sigma * normal[4]),
        force[1] + (bias[3] + p.acceleration_sigma * normal[5]),
        force[2] + (bias[4] + p.acceleration_sigma * normal[6]),
    )
