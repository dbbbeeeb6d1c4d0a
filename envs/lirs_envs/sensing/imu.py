"""Inertial unit: attitude, rates and specific force, with noise and bias.

Figures of a small MEMS unit that was zeroed while the robot stood still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray, njit
from lirs_wct.checks import Checked, limited
from lirs_wct.geometry import Imu

RATE_BLOCK = 256
"""Readings of the gyro whose noise is drawn at once."""


@dataclass(frozen=True, kw_only=True)
class ImuConfig(Checked, of="the IMU"):
    """Noise of an inertial unit; standard deviations.

    Attributes:
        attitude_sigma: white noise of roll and pitch in each reading, radians.
        attitude_bias: slowly varying error of roll and pitch, radians.
        attitude_time: correlation time of `attitude_bias`, seconds (first-order Gauss-Markov process).
        rate_sigma: white noise of each rate in each update, rad/s.
        rate_bias: constant error of each rate, drawn at a reset, rad/s.
        acceleration_sigma: white noise of each acceleration in each reading, m/s^2.
        acceleration_bias: constant error of each acceleration, drawn at a reset, m/s^2.
    """

    attitude_sigma: float = limited(math.radians(0.1), "[0, inf)")
    attitude_bias: float = limited(math.radians(0.1), "[0, inf)")
    attitude_time: float = limited(10.0, "(0, inf)", "s")
    rate_sigma: float = limited(math.radians(0.1), "[0, inf)")
    rate_bias: float = limited(math.radians(0.02), "[0, inf)")
    acceleration_sigma: float = limited(0.05, "[0, inf)")
    acceleration_bias: float = limited(0.02, "[0, inf)")


class ImuParameters(NamedTuple):
    """Standard deviations of an `ImuConfig` as the kernel reads them; `attitude_time` in seconds."""

    attitude_sigma: float
    attitude_bias: float
    attitude_time: float
    acceleration_sigma: float


class ImuSensors:
    """N inertial units, each with its own biases and random stream.

    Attributes:
        rates: (N, 3) last reading of the gyro about x, y, z of the base, rad/s.
        attitude: (N, 2) roll and pitch, radians.
        force: (N, 3) specific force along x, y, z of the base, m/s^2.
        rate_bias: (N, 3) constant errors of the rates, rad/s.
    """

    def __init__(self, config: ImuConfig, count: int) -> None:
        self.config = config
        c = config
        self._parameters = ImuParameters(
            *map(float, (c.attitude_sigma, c.attitude_bias, c.attitude_time, c.acceleration_sigma))
        )
        self._rngs = [np.random.default_rng(0) for _ in range(count)]
        self.rates, self.force = np.zeros((count, 3)), np.zeros((count, 3))
        self.attitude = np.zeros((count, 2))
        self.rate_bias = np.zeros((count, 3))
        # Slowly varying errors of roll and pitch, radians, constant ones of the acceleration.
        self._bias = np.zeros((count, 5))
        # Errors of the coming gyro readings, the last row first, rad/s, and the number of unused rows.
        self._rate_errors, self._rates_left = np.zeros((count, RATE_BLOCK, 3)), np.zeros(count, np.int64)
        self._used_up = True
        self._normals = np.zeros((count, 7))

    def begin(self, i: int, qpos: FloatArray, qvel: FloatArray, rng: np.random.Generator) -> None:
        """Draw new biases of unit `i`, which stands still with a known attitude."""
        config, self._rngs[i] = self.config, rng
        bias = rng.standard_normal(8)
        self.rate_bias[i] = bias[:3] * config.rate_bias
        self._bias[i, :2], self._bias[i, 2:] = (
            bias[6:] * config.attitude_bias,
            bias[3:6] * config.acceleration_bias,
        )
        self._rates_left[i], self._used_up = 0, True
        self.read_rates(np.array((i,)), qvel)
        self.attitude[i] = _attitude(qpos[i])

    def read_rates(self, ids: IntArray, qvel: FloatArray) -> None:
        """Read the gyros from true velocities (N, nv)."""
        if self._used_up:
            self._draw_rate_errors()
        self._used_up = _read_rates(ids, qvel, self._rate_errors, self._rates_left, self.rates)

    def _draw_rate_errors(self) -> None:
        """Draw a new block of errors where one is used up. Single draws would cost more than the reading."""
        for i in np.flatnonzero(self._rates_left == 0).tolist():
            noise = self._rngs[i].standard_normal((RATE_BLOCK, 3))
            self._rate_errors[i] = self.rate_bias[i] + self.config.rate_sigma * noise
            self._rates_left[i] = RATE_BLOCK

    def read(self, ids: IntArray, qpos: FloatArray, force: FloatArray, dt: float) -> None:
        """Read attitude and specific force, `dt` seconds after the last reading.

        Args:
            ids: rows of the units.
            qpos: (N, nq) true positions.
            force: (N, 3) true specific force, m/s^2.
            dt: seconds.
        """
        for i in ids.tolist():
            self._rngs[i].standard_normal(out=self._normals[i])
        noise = self._bias, self._normals
        _read(ids, (qpos, force), noise, dt, self._parameters, self.attitude, self.force)

    def reading(self, i: int, stamp: float) -> Imu:
        """Return the last reading of unit `i`."""
        roll, pitch = self.attitude[i].tolist()
        return Imu(roll, pitch, tuple(self.rates[i].tolist()), tuple(self.force[i].tolist()), stamp)


@njit
def _read_rates(
    ids: IntArray, qvel: FloatArray, errors: FloatArray, left: IntArray, rates: FloatArray
) -> bool:
    """Fill rows of `rates`; return whether the errors of one are used up."""
    used_up = False
    for n in range(len(ids)):
        i = ids[n]
        left[i] -= 1
        for k in range(3):
            rates[i, k] = qvel[i, 3 + k] + errors[i, left[i], k]
        used_up |= left[i] == 0
    return used_up


@njit
def _read(
    ids: IntArray,
    true: tuple[FloatArray, FloatArray],
    noise: tuple[FloatArray, FloatArray],
    dt: float,
    parameters: ImuParameters,
    attitude: FloatArray,
    force: FloatArray,
) -> None:
    """Fill rows of `attitude` and `force`; the biases (N, 5) advance by `dt` seconds."""
    (qpos, true_force), (bias, normals), p = true, noise, parameters
    keep = math.exp(-dt / p.attitude_time)
    fresh = math.sqrt(1 - keep * keep) * p.attitude_bias
    for n in range(len(ids)):
        i = ids[n]
        errors, normal = bias[i], normals[i]
        roll, pitch = _attitude(qpos[i])
        errors[0] = keep * errors[0] + fresh * normal[0]
        errors[1] = keep * errors[1] + fresh * normal[1]
        attitude[i, 0] = roll + (errors[0] + p.attitude_sigma * normal[2])
        attitude[i, 1] = pitch + (errors[1] + p.attitude_sigma * normal[3])
        for k in range(3):
            force[i, k] = true_force[i, k] + (errors[2 + k] + p.acceleration_sigma * normal[4 + k])


@njit
def _attitude(qpos: FloatArray) -> tuple[float, float]:
    """Return roll and pitch of a free body, radians."""
    norm = math.sqrt(qpos[3] * qpos[3] + qpos[4] * qpos[4] + qpos[5] * qpos[5] + qpos[6] * qpos[6])
    w, x, y, z = qpos[3] / norm, qpos[4] / norm, qpos[5] / norm, qpos[6] / norm
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    return math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), pitch
