"""IMU: yaw rate and attitude at each scan, and an inertial unit near 200 Hz, with bias and noise.

The figures of the inertial unit at each scan are those of a small MEMS unit that was zeroed while the robot
stood still.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import FloatArray, ImuReadings, IntArray, njit

RATE_BLOCK = 256
"""Number of gyro readings whose noise is drawn at once: single draws would cost more than the reading."""


@dataclass(frozen=True, kw_only=True)
class ImuConfig(Checked, of="the IMU"):
    """Noise of an inertial unit; standard deviations.

    Attributes:
        attitude_sigma: White noise of roll and pitch in each reading, radians.
        attitude_bias: Slowly varying error of roll and pitch, radians.
        attitude_time: Correlation time of `attitude_bias`, seconds (first-order Gauss-Markov process).
        rate_sigma: White noise of each rate in each update, rad/s.
        rate_bias: Constant error of each rate, drawn at a reset, rad/s.
        acceleration_sigma: White noise of each acceleration in each reading, m/s^2.
        acceleration_bias: Constant error of each acceleration, drawn at a reset, m/s^2.
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
        read_rates: Function that reads the gyros of robots `ids` from true velocities (N, nv).

    Args:
        updates: Largest number of gyro readings between two calls of `read`.
    """

    read_rates: Callable[[IntArray, FloatArray], None]

    def __init__(self, config: ImuConfig, count: int, updates: int = 1) -> None:
        self.config = c = config
        self._parameters = ImuParameters(
            *map(float, (c.attitude_sigma, c.attitude_bias, c.attitude_time, c.acceleration_sigma))
        )
        self._updates = updates
        self._rngs = [np.random.default_rng(0) for _ in range(count)]
        self.rates, self.force = np.zeros((count, 3)), np.zeros((count, 3))
        self.attitude = np.zeros((count, 2))
        self.rate_bias = np.zeros((count, 3))
        # Slowly varying errors of roll and pitch, radians, constant ones of the acceleration.
        self._bias = np.zeros((count, 5))
        # Errors of the coming gyro readings, the last row first, rad/s, and the number of unused rows.
        self._rate_errors, self._rates_left = (
            np.zeros((count, RATE_BLOCK + updates, 3)),
            np.zeros(count, np.int64),
        )
        self._normals = np.zeros((count, 7))
        # No method: a call of one takes as long as the kernel.
        self.read_rates = partial(_read_rates, self._rate_errors, self._rates_left, self.rates)

    def begin(self, i: int, qpos: FloatArray, qvel: FloatArray, rng: np.random.Generator) -> None:
        """Draw new biases of unit `i`, which stands still with a known attitude."""
        config, self._rngs[i] = self.config, rng
        bias = rng.standard_normal(8)
        self.rate_bias[i] = bias[:3] * config.rate_bias
        self._bias[i, :2] = bias[6:] * config.attitude_bias
        self._bias[i, 2:] = bias[3:6] * config.acceleration_bias
        self._rates_left[i] = 0
        row = np.array((i,))
        self.draw(row, 1)
        self.read_rates(row, qvel)
        self.attitude[i] = _attitude(qpos[i])

    def draw(self, ids: IntArray, updates: int) -> None:
        """Draw the errors of the next gyro readings where fewer than `updates` are left."""
        for i in ids[self._rates_left[ids] < updates].tolist():
            left, errors = self._rates_left[i], self._rate_errors[i]
            noise = self._rngs[i].standard_normal((RATE_BLOCK, 3))
            errors[RATE_BLOCK : RATE_BLOCK + left] = errors[:left].copy()
            errors[:RATE_BLOCK] = self.rate_bias[i] + self.config.rate_sigma * noise
            self._rates_left[i] += RATE_BLOCK

    def read(self, ids: IntArray, qpos: FloatArray, force: FloatArray, dt: float) -> None:
        """Read attitude and specific force, `dt` seconds after the last reading.

        Then draw the noise of the next period. The true positions are (N, nq), the force is (N, 3), m/s^2.
        """
        for i in ids.tolist():
            self._rngs[i].standard_normal(out=self._normals[i])
        noise = self._bias, self._normals
        _read(ids, (qpos, force), noise, dt, self._parameters, self.attitude, self.force)
        self.draw(ids, self._updates)


@njit
def _read_rates(
    errors: FloatArray, left: IntArray, rates: FloatArray, ids: IntArray, qvel: FloatArray
) -> None:
    """Fill rows of `rates`."""
    for n in range(len(ids)):
        i = ids[n]
        left[i] -= 1
        for k in range(3):
            rates[i, k] = qvel[i, 3 + k] + errors[i, left[i], k]


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


INERTIAL_RATE = 200.0
"""Aimed number of readings a second; one covers a whole number of physics steps."""
MOTION = 10
"""Numbers that describe the motion of the base: quaternion (4), velocity (3), rates (3)."""
STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, kw_only=True)
class InertialNoise(Checked, of="the inertial unit"):
    """Noise densities and constant biases of an inertial unit.

    The densities are those of the data sheet of Bosch's BMI088; the biases are what remains after a
    calibration at rest.

    Attributes:
        rate_density: White noise of each rate, rad/s/sqrt(Hz).
        rate_bias: Standard deviation of the constant error of each rate, rad/s.
        acceleration_density: White noise of each acceleration, m/s^2/sqrt(Hz).
        acceleration_bias: Standard deviation of the constant error of each acceleration, m/s^2.
    """

    rate_density: float = limited(math.radians(0.014), "[0, inf)")
    rate_bias: float = limited(math.radians(0.02), "[0, inf)")
    acceleration_density: float = limited(175e-6 * STANDARD_GRAVITY, "[0, inf)")
    acceleration_bias: float = limited(0.02, "[0, inf)")


class InertialUnit:
    """Inertial unit at the base's origin, which reads the steps of the physics.

    Attributes:
        rate: Readings a second, Hz.
    """

    def __init__(self, noise: InertialNoise, timestep: float, gravity: float) -> None:
        self._steps = max(1, round(1 / (INERTIAL_RATE * timestep)))
        self.rate = 1 / (self._steps * timestep)
        self._noise, self._timestep, self._gravity = noise, timestep, gravity
        densities = np.repeat((noise.rate_density, noise.acceleration_density), 3)
        self._sigmas = math.sqrt(self.rate) * densities
        self.begin(np.zeros(MOTION), np.random.default_rng(0))

    def begin(self, state: FloatArray, rng: np.random.Generator) -> None:
        """Start with the base's state (10,) at time 0, with new biases."""
        self._rng, noise = rng, self._noise
        self._bias = rng.standard_normal(6) * np.repeat((noise.rate_bias, noise.acceleration_bias), 3)
        # The state before the first step that no reading covers yet, and the states after such steps.
        self._pending = state[None].copy()
        self._done = 0

    def read(self, states: FloatArray) -> ImuReadings:
        """Return the readings whose intervals end with the next steps.

        Args:
            states: (n, 10) states of the base after each step since the last call.
        """
        pending = np.concatenate((self._pending, states))
        means = _means(pending, self._steps, self._timestep, self._gravity)
        count = len(means)
        readings = means + self._bias + self._sigmas * self._rng.standard_normal((count, 6))
        stamps = (self._done + np.arange(1, count + 1)) / self.rate
        self._pending, self._done = pending[count * self._steps :], self._done + count
        return ImuReadings(stamps, readings[:, :3], readings[:, 3:], *self._sigmas[::3].tolist())


@njit
def _means(states: FloatArray, steps: int, dt: float, gravity: float) -> FloatArray:
    """Return (n, 6) mean rates, rad/s, and specific force, m/s^2, of n times `steps` steps of `dt` seconds.

    The mean over a step is exact: MuJoCo turns the base by the rates after the step, and the force is the
    change of velocity, seen from the attitude in the middle of the step. States (n * steps + 1, 10) are those
    of the base before and after each step.
    """
    means = np.zeros(((len(states) - 1) // steps, 6))
    for k in range(len(means) * steps):
        before, after, mean = states[k], states[k + 1], means[k // steps]
        w, x, y, z = before[:4] + after[:4]
        scale = 1 / (w * w + x * x + y * y + z * z)
        ax, ay, az = (after[4:7] - before[4:7]) / dt
        az += gravity
        # Rotated by the conjugate of the quaternion (w, x, y, z).
        cx, cy, cz = z * ay - y * az, x * az - z * ax, y * ax - x * ay
        mean[:3] += after[7:]
        mean[3] += ax + 2 * scale * (w * cx + z * cy - y * cz)
        mean[4] += ay + 2 * scale * (w * cy + x * cz - z * cx)
        mean[5] += az + 2 * scale * (w * cz + y * cx - x * cy)
    return means / steps
