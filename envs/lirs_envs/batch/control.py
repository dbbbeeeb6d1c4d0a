"""Control of N wheeled robots: the kernel of a single robot for each row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lirs_envs.robots.drive import DriveConfig, drive_parameters, wheel_speeds
from lirs_envs.robots.robot import Robot
from lirs_wct.arrays import FloatArray, IntArray, RecordArray
from lirs_wct.kernels import njit


class WheelActuators(NamedTuple):
    """Actuators of the driven wheels."""

    left: IntArray
    right: IntArray


class DifferentialDrives:
    """Wheel speeds of N robots with driven wheels on both sides (see `robots.drive.DifferentialDrive`)."""

    def __init__(self, robot: Robot, actuators: WheelActuators, count: int) -> None:
        self._actuators = actuators
        self._parameters = drive_parameters(robot, DriveConfig())
        self._state = np.zeros((count, 3))

    def begin(self, i: int) -> None:
        """Reset the control of robot `i` at rest."""
        self._state[i] = 0.0

    def update(
        self, ids: IntArray, commands: FloatArray, rates: FloatArray, dt: float, ctrl: FloatArray
    ) -> None:
        """Fill the controls (N, nu) to hold for `dt` seconds.

        Args:
            ids: rows of the robots.
            commands: (N, 2 or more) speeds, m/s, and turn rates, rad/s.
            rates: (N, 3) measured by the gyro, rad/s.
            dt: seconds.
            ctrl: wheel speeds, rad/s.
        """
        _drive(ids, commands, rates, dt, self._parameters, self._actuators, self._state, ctrl)


@njit(cache=True, nogil=True)
def _drive(
    ids: IntArray,
    commands: FloatArray,
    rates: FloatArray,
    dt: float,
    parameters: RecordArray,
    actuators: WheelActuators,
    state: FloatArray,
    ctrl: FloatArray,
) -> None:
    for n in range(len(ids)):
        i = ids[n]
        left, right = wheel_speeds(state[i], commands[i, 0], commands[i, 1], rates[i, 2], dt, parameters)
        for a in actuators.left:
            ctrl[i, a] = left
        for a in actuators.right:
            ctrl[i, a] = right
