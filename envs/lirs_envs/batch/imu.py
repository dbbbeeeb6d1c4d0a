"""Inertial readings of N robots: the kernels of a single robot for each row."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.sensing.imu import ImuConfig, ImuParameters, ImuSensors, next_rates, read_imu
from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.kernels import njit


class ImuReadings:
    """Readings of N inertial units.

    Attributes:
        rates: (N, 3) last reading of the gyro about x, y, z of the base, rad/s.
        attitude: (N, 2) roll and pitch, radians.
        force: (N, 3) specific force along x, y, z of the base, m/s^2.
    """

    def __init__(self, config: ImuConfig, count: int) -> None:
        self._sensors = ImuSensors(config, count)
        self.rates, self.force = np.zeros((count, 3)), np.zeros((count, 3))
        self.attitude = np.zeros((count, 2))
        self._used_up = True

    def begin(self, i: int, qpos: FloatArray, qvel: FloatArray, rng: np.random.Generator) -> None:
        """Start unit `i` at rest with a known attitude."""
        self._sensors.begin(i, rng)
        self._used_up = True
        self.read_rates(np.array((i,)), qvel)
        self.attitude[i] = _attitude(qpos[i])

    def read_rates(self, ids: IntArray, qvel: FloatArray) -> None:
        """Read the gyros."""
        sensors = self._sensors
        if self._used_up:
            sensors.draw_rate_errors()
        self._used_up = _read_rates(ids, qvel, sensors.rate_errors, sensors.rates_left, self.rates)

    def read(self, ids: IntArray, qpos: FloatArray, force: FloatArray, dt: float) -> None:
        """Read attitude and specific force, `dt` seconds after the last reading."""
        sensors = self._sensors
        for i in ids.tolist():
            sensors.draw_reading(i)
        _read(
            ids,
            (qpos, force),
            (sensors.bias, sensors.normals),
            dt,
            sensors.parameters,
            self.attitude,
            self.force,
        )


@njit(cache=True, nogil=True)
def _read_rates(
    ids: IntArray, qvel: FloatArray, errors: FloatArray, left: IntArray, rates: FloatArray
) -> bool:
    """Fill rows of `rates`; return whether the errors of one are used up."""
    used_up = False
    for n in range(len(ids)):
        i = ids[n]
        true = (qvel[i, 3], qvel[i, 4], qvel[i, 5])
        rates[i, 0], rates[i, 1], rates[i, 2] = next_rates(errors[i], left[i : i + 1], true)
        used_up |= left[i] == 0
    return used_up


@njit(cache=True, nogil=True)
def _read(
    ids: IntArray,
    true: tuple[FloatArray, FloatArray],
    noise: tuple[FloatArray, FloatArray],
    dt: float,
    parameters: ImuParameters,
    attitude: FloatArray,
    force: FloatArray,
) -> None:
    qpos, true_force = true
    bias, normals = noise
    for n in range(len(ids)):
        i = ids[n]
        f = (true_force[i, 0], true_force[i, 1], true_force[i, 2])
        roll, pitch, x, y, z = read_imu(bias[i], normals[i], _attitude(qpos[i]), f, dt, parameters)
        attitude[i, 0], attitude[i, 1] = roll, pitch
        force[i, 0], force[i, 1], force[i, 2] = x, y, z


@njit(cache=True, nogil=True)
def _attitude(qpos: FloatArray) -> tuple[float, float]:
    """Return roll and pitch of a free body, radians."""
    norm = math.sqrt(qpos[3] * qpos[3] + qpos[4] * qpos[4] + qpos[5] * qpos[5] + qpos[6] * qpos[6])
    w, x, y, z = qpos[3] / norm, qpos[4] / norm, qpos[5] / norm, qpos[6] / norm
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    return math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), pitch
