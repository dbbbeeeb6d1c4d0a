"""Inertial readings near 200 Hz: means over their intervals, with noise and bias."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import FloatArray, njit
from lirs_wct.checks import Checked, limited
from lirs_wct.geometry import ImuReadings

RATE = 200.0
"""Aimed number of readings a second; one covers a whole number of physics steps."""
COLUMNS = 10
"""Numbers that describe the base after a step: quaternion (4), velocity (3), rates (3)."""
STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, kw_only=True)
class InertialNoise(Checked, of="the inertial unit"):
    """Noise densities and constant biases of an inertial unit.

    The densities are those of the data sheet of Bosch's BMI088; the biases are what remains after a
    calibration at rest.

    Attributes:
        rate_density: white noise of each rate, rad/s/sqrt(Hz).
        rate_bias: standard deviation of the constant error of each rate, rad/s.
        acceleration_density: white noise of each acceleration, m/s^2/sqrt(Hz).
        acceleration_bias: standard deviation of the constant error of each acceleration, m/s^2.
    """

    rate_density: float = limited(math.radians(0.014), "[0, inf)")
    rate_bias: float = limited(math.radians(0.02), "[0, inf)")
    acceleration_density: float = limited(175e-6 * STANDARD_GRAVITY, "[0, inf)")
    acceleration_bias: float = limited(0.02, "[0, inf)")


class InertialUnit:
    """Inertial unit at the base's origin, which reads the steps of the physics.

    Attributes:
        steps: physics steps of one reading.
        rate: readings a second, Hz.

    Args:
        noise: densities and biases.
        timestep: of the physics, seconds.
        gravity: along -z, m/s^2.
    """

    def __init__(self, noise: InertialNoise, timestep: float, gravity: float) -> None:
        self.steps = max(1, round(1 / (RATE * timestep)))
        self.rate = 1 / (self.steps * timestep)
        self._noise, self._timestep, self._gravity = noise, timestep, gravity
        densities = np.repeat((noise.rate_density, noise.acceleration_density), 3)
        self._sigmas = math.sqrt(self.rate) * densities
        self.begin(np.zeros(COLUMNS), np.random.default_rng(0))

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
            states: (n, 10) states of the base after each of the n steps since the last call.
        """
        pending = np.concatenate((self._pending, states))
        means = _means(pending, self.steps, self._timestep, self._gravity)
        count = len(means)
        readings = means + self._bias + self._sigmas * self._rng.standard_normal((count, 6))
        stamps = (self._done + np.arange(1, count + 1)) / self.rate
        self._pending, self._done = pending[count * self.steps :], self._done + count
        return ImuReadings(stamps, readings[:, :3], readings[:, 3:], *self._sigmas[::3].tolist())


@njit
def _means(states: FloatArray, steps: int, dt: float, gravity: float) -> FloatArray:
    """Return (n, 6) mean rates, rad/s, and specific force, m/s^2, of n times `steps` steps.

    The mean over a step is exact: MuJoCo turns the base by the rates after the step, and the force is the
    change of velocity, seen from the attitude in the middle of the step.

    Args:
        states: (n * steps + 1, 10) states of the base before and after each step.
        steps: physics steps of one reading.
        dt: duration of a step, seconds.
        gravity: along -z, m/s^2.
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
