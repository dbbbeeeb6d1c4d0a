"""Control of N robots: driven wheels, or rotors, from commanded twists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lirs_envs.robots.body_state import BodyState
from lirs_envs.robots.flight import QuadrotorController
from lirs_envs.robots.robot import Robot, Twist, Waypoint
from lirs_wct.arrays import FloatArray, IntArray, RecordArray, njit
from lirs_wct.checks import Checked, limited
from lirs_wct.geometry.heightfield import HeightField


@dataclass(frozen=True, kw_only=True)
class DriveConfig(Checked, of="the yaw loop"):
    """Gains of the yaw loop, which corrects the error of the feed-forward.

    Attributes:
        proportional: extra turn rate per rad/s of error.
        integral: extra turn rate per radian of error.
        integral_limit: largest integral part, rad/s.
    """

    proportional: float = limited(0.3, "[0, inf)")
    integral: float = limited(4.0, "[0, inf)")
    integral_limit: float = limited(1.0, "[0, inf)")


LIMITS = (
    "max_speed",
    "max_turn_rate",
    "max_acceleration",
    "max_turn_acceleration",
    "skid_factor",
    "track",
    "wheel_radius",
)
GAINS = ("proportional", "integral", "integral_limit")
DRIVE = np.dtype([(name, np.float64) for name in (*LIMITS, *GAINS)])
"""Limits of a robot and gains of its yaw loop as the kernel reads them: in an array, because a tuple of ten
numbers takes longer to hand over than the kernel runs."""


class WheelActuators(NamedTuple):
    """Indices of the driven wheels' actuators."""

    left: IntArray
    right: IntArray


class DifferentialDrives:
    """Wheel speeds of N robots with driven wheels on both sides.

    The command is limited in speed and acceleration. A skid-steered robot turns slower than its wheels imply,
    by a factor that depends on slope and load. `Robot.skid_factor` is fed forward, and a PI loop on the gyro
    corrects the remaining error.
    """

    def __init__(self, robot: Robot, actuators: WheelActuators, count: int) -> None:
        self._actuators = actuators
        config = DriveConfig()
        figures = [getattr(robot, name) for name in LIMITS] + [getattr(config, name) for name in GAINS]
        self._parameters = np.array([tuple(figures)], DRIVE)
        self._state = np.zeros((count, 3))

    def begin(self, i: int) -> None:
        """Reset the control of robot `i` at rest."""
        self._state[i] = 0.0

    def update(
        self, ids: IntArray, commands: FloatArray, rates: FloatArray, dt: float, ctrl: FloatArray
    ) -> None:
        """Fill the controls to hold for `dt` seconds: wheel speeds, rad/s.

        Args:
            ids: rows of the robots.
            commands: (N, 3) speeds, m/s, turn rates, rad/s, climbs, m/s; clipped to the robot's limits.
            rates: (N, 3) measured by the gyro, rad/s.
            dt: seconds.
            ctrl: (N, nu) controls.
        """
        _drive(ids, commands, rates, dt, self._parameters, self._actuators, self._state, ctrl)


@njit
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


@njit
def wheel_speeds(
    state: FloatArray, v: float, omega: float, yaw_rate: float, dt: float, parameters: RecordArray
) -> tuple[float, float]:
    """Return the speeds of left and right wheels, rad/s, and update the state.

    Args:
        state: (3,) commanded speed and turn rate within the accelerations, integral of the yaw loop.
        v: commanded speed, m/s.
        omega: commanded turn rate, rad/s.
        yaw_rate: measured by the gyro, rad/s.
        dt: seconds until the next update.
        parameters: (1,) of `DRIVE`.
    """
    p = parameters[0]
    v, omega = _limit(v, p.max_speed), _limit(omega, p.max_turn_rate)
    state[0] += _limit(v - state[0], p.max_acceleration * dt)
    state[1] += _limit(omega - state[1], p.max_turn_acceleration * dt)
    if state[0] == 0.0 and state[1] == 0.0:
        # Standing: the wheels hold, the gyro's bias must not turn the robot.
        state[2] = 0.0
        return 0.0, 0.0
    error = state[1] - yaw_rate
    state[2] = _limit(state[2] + p.integral * error * dt, p.integral_limit)
    side = (state[1] + p.proportional * error + state[2]) * p.skid_factor * p.track / 2
    return (state[0] - side) / p.wheel_radius, (state[0] + side) / p.wheel_radius


@njit(inline="always")
def _limit(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


class FlightControllers:
    """Rotor thrusts of N quadrotors.

    Args:
        surfaces: the ground of each quadrotor; replaceable.
        waypoints: the pose that each quadrotor flies to instead of its command; None = the command.
    """

    def __init__(
        self,
        robot: Robot,
        bodies: Sequence[BodyState],
        surfaces: Sequence[HeightField],
        waypoints: Sequence[Waypoint | None],
    ) -> None:
        self._robot, self._bodies, self._surfaces, self._waypoints = robot, bodies, surfaces, waypoints
        self._controllers: dict[int, QuadrotorController] = {}

    def begin(self, i: int) -> None:
        """Create the controller of quadrotor `i` at its present pose."""
        self._controllers[i] = QuadrotorController(self._robot, self._bodies[i], self._surfaces[i])

    def update(
        self, ids: IntArray, commands: FloatArray, rates: FloatArray, dt: float, ctrl: FloatArray
    ) -> None:
        """Fill the thrusts, newtons (see `DifferentialDrives.update`)."""
        for i in ids.tolist():
            command = self._waypoints[i] or Twist(*commands[i].tolist())
            ctrl[i] = self._controllers[i].update(command, dt)


Controllers = DifferentialDrives | FlightControllers


def make_controllers(
    robot: Robot,
    actuators: Sequence[Sequence[int]],
    bodies: Sequence[BodyState],
    surfaces: Sequence[HeightField] = (),
    waypoints: Sequence[Waypoint | None] = (),
) -> Controllers:
    """Return the controllers of robots (see `DifferentialDrives` and `FlightControllers`).

    `actuators` are those of the wheels on the left and on the right. Only flying robots need surfaces and
    waypoints.
    """
    if robot.flies:
        return FlightControllers(robot, bodies, surfaces, waypoints)
    left, right = (np.array(side, np.int64) for side in actuators)
    return DifferentialDrives(robot, WheelActuators(left, right), len(bodies))
