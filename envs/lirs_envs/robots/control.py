"""State and control of a robot: driven wheels or rotors from commanded twists.

The flight control is the cascade of the Hector quadrotor (Meyer et al., "Comprehensive simulation of
quadrotor UAVs using ROS and Gazebo", SIMPAR 2012). Position gives a wanted velocity, velocity a wanted
acceleration, which is a thrust and a tilt. The attitude loop gives torques. The control reads the true state,
like Hector's default.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np

from lirs_envs.robots.robot import Robot, Twist, Waypoint, clip
from lirs_wct.arrays import FloatArray, IntArray, RecordArray, Vector3, njit
from lirs_wct.geometry import HeightField, Pose3, wrap_angle


class BodyState:
    """True state of one robot in the world frame, for its sensors and control.

    From positions and velocities: MuJoCo's sensors lie one step behind them.

    Attributes:
        wheels: Joints of the driven wheels.
        qpos: (nq,) positions, live; the first seven are those of `T_world_base`.
        qvel: (nv,) velocities, live.
    """

    qpos: FloatArray
    qvel: FloatArray

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        self.model = model
        left, right = (
            np.array([int(model.joint(name).qposadr[0]) for name in side], np.int64)
            for side in (robot.left_wheels, robot.right_wheels)
        )
        self.wheels = WheelJoints(left, right, robot.wheel_radius)

    @property
    def gravity(self) -> float:
        """Gravity along -z, m/s^2."""
        return -float(self.model.opt.gravity[2])

    def pose(self) -> Pose3:
        """Return `T_world_base`."""
        x, y, z, qw, qx, qy, qz = self.qpos[:7].tolist()
        norm = math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        return Pose3(x, y, z, qw / norm, qx / norm, qy / norm, qz / norm)

    def rates(self) -> Vector3:
        """Return the rates about x, y, z of the base, rad/s."""
        x, y, z = self.qvel[3:6].tolist()
        return x, y, z

    def velocity(self) -> Vector3:
        """Return the velocity of base_link along x, y, z of the base, m/s."""
        x, y, z = (self.qvel[:3] @ self.pose().rotation).tolist()
        return x, y, z

    def wheel_angles(self) -> tuple[float, float]:
        """Return the mean angles by which left and right wheels have turned, radians."""
        return mean_angle(self.qpos, self.wheels.left), mean_angle(self.qpos, self.wheels.right)


class WheelJoints(NamedTuple):
    """Addresses of the driven wheels' angles in `qpos`, and the wheel radius, meters."""

    left: IntArray
    right: IntArray
    radius: float


@njit
def mean_angle(qpos: FloatArray, joints: IntArray) -> float:
    """Return the mean angle of some wheels, radians, from a state's positions (nq,)."""
    total = 0.0
    for k in range(len(joints)):
        total += qpos[joints[k]]
    return total / max(len(joints), 1)


PROPORTIONAL, INTEGRAL, INTEGRAL_LIMIT = 0.3, 4.0, 1.0
"""Gains of the yaw loop, which corrects the error of the feed-forward: extra turn rate per rad/s and per
radian of error, and the largest integral part, rad/s."""
LIMITS = (
    "max_speed",
    "max_turn_rate",
    "max_acceleration",
    "max_turn_acceleration",
    "skid_factor",
    "track",
    "wheel_radius",
)
DRIVE = np.dtype([(name, np.float64) for name in LIMITS])
"""Limits of a robot as the kernel reads them: in an array, because a tuple of numbers takes longer to hand
over than the kernel runs."""


class DifferentialDrives:
    """Wheel speeds of N robots with driven wheels on both sides.

    The command is limited in speed and acceleration. A skid-steered robot turns slower than its wheels imply,
    by a factor that depends on slope and load. `Robot.skid_factor` is fed forward, and a PI loop on the gyro
    corrects the remaining error.

    Attributes:
        update: Function that fills the controls, wheel speeds in rad/s (see `_drive`).
    """

    update: Callable[[IntArray, FloatArray, FloatArray, float, FloatArray], None]

    def __init__(self, robot: Robot, actuators: tuple[IntArray, IntArray], count: int) -> None:
        limits = np.array([tuple(getattr(robot, name) for name in LIMITS)], DRIVE)
        self._state = np.zeros((count, 3))
        # No method: a call of one takes as long as the kernel.
        self.update = partial(_drive, limits, actuators, self._state)

    def begin(self, i: int) -> None:
        """Reset the control of robot `i` at rest."""
        self._state[i] = 0.0


@njit
def _drive(
    limits: RecordArray,
    actuators: tuple[IntArray, IntArray],
    state: FloatArray,
    ids: IntArray,
    commands: FloatArray,
    rates: FloatArray,
    dt: float,
    ctrl: FloatArray,
) -> None:
    """Fill the controls (N, nu) of robots `ids` to hold for `dt` seconds.

    Commands (N, 3) are speeds, m/s, turn rates, rad/s, climbs, m/s, clipped to the robot's limits; rates (N,
    3) those of the gyro, rad/s; actuators the ids on the left and on the right; states (N, 3) of
    `wheel_speeds`.
    """
    for n in range(len(ids)):
        i = ids[n]
        left, right = wheel_speeds(state[i], commands[i, 0], commands[i, 1], rates[i, 2], dt, limits)
        for a in actuators[0]:
            ctrl[i, a] = left
        for a in actuators[1]:
            ctrl[i, a] = right


@njit
def wheel_speeds(
    state: FloatArray, v: float, omega: float, yaw_rate: float, dt: float, limits: RecordArray
) -> tuple[float, float]:
    """Return the speeds of left and right wheels, rad/s, and update the state.

    Args:
        state: (3,) commanded speed and turn rate within the accelerations, integral of the yaw loop.
        v: Commanded speed, m/s.
        omega: Commanded turn rate, rad/s.
        yaw_rate: Rate measured by the gyro, rad/s.
        dt: Seconds until the next update.
        limits: (1,) limits of `DRIVE`.
    """
    p = limits[0]
    v, omega = _limit(v, p.max_speed), _limit(omega, p.max_turn_rate)
    state[0] += _limit(v - state[0], p.max_acceleration * dt)
    state[1] += _limit(omega - state[1], p.max_turn_acceleration * dt)
    if state[0] == 0.0 and state[1] == 0.0:
        # Standing: the wheels hold, the gyro's bias must not turn the robot.
        state[2] = 0.0
        return 0.0, 0.0
    error = state[1] - yaw_rate
    state[2] = _limit(state[2] + INTEGRAL * error * dt, INTEGRAL_LIMIT)
    side = (state[1] + PROPORTIONAL * error + state[2]) * p.skid_factor * p.track / 2
    return (state[0] - side) / p.wheel_radius, (state[0] + side) / p.wheel_radius


@njit(inline="always")
def _limit(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


MIN_THRUST = 0.3
"""Least vertical thrust as a share of the weight: a body in free fall cannot turn."""


POSITION_GAIN, VELOCITY_GAIN, HEADING_GAIN = 1.5, 5.0, 2.0
"""Wanted speed a meter of error, acceleration a m/s of error, yaw rate a radian of error; 1/s."""
ATTITUDE_GAIN, RATE_GAIN = 220.0, 24.0
"""Angular acceleration a radian of error, 1/s^2, and a rad/s of error, 1/s."""
MAX_TILT, MAX_CLIMB_RATE = math.radians(45), 5.0
"""Largest tilt, radians, and vertical speed, m/s."""
ALTITUDE, MIN_ALTITUDE, MAX_ALTITUDE = 1.0, 0.6, 10.0
"""Height above the ground in terrain following at the start, and its limits after a climb, meters."""
LOOKAHEAD = 0.8
"""Time ahead over which the ground counts in terrain following, seconds."""


class QuadrotorController:
    """Rotor thrusts from commands.

    A `Twist` flies ahead and turns at an altitude above the highest ground within the lookahead. The altitude
    begins at `ALTITUDE`, and a climb changes it. Without motion the robot holds its position. A
    `Waypoint` is a pose to fly to and hold.
    """

    def __init__(self, robot: Robot, body: BodyState, surface: HeightField) -> None:
        self.robot, self._body, self._surface = robot, body, surface
        self._hold: Waypoint | None = None
        self._v = self._omega = 0.0
        self._altitude = ALTITUDE
        model = body.model
        base = model.body("base_link")
        # Inertia about the body's axes.
        self._mass, self._inertia = float(base.mass[0]), np.array(base.inertia)
        ids = [model.actuator(name).id for name in robot.rotors]
        sites = model.site_pos[model.actuator_trnid[ids, 0]]
        drag = model.actuator_gear[ids, 5]
        # One newton along z at (x, y): torque (y, -x, drag).
        wrench = np.stack((np.ones(len(ids)), sites[:, 1], -sites[:, 0], drag), axis=1)
        self._allocation = np.linalg.pinv(wrench.T)
        self._max_thrust = float(model.actuator_ctrlrange[ids, 1].sum())

    def update(self, command: Twist | Waypoint, dt: float) -> FloatArray:
        """Return the thrust (rotors,) of each rotor for `dt` seconds, newtons."""
        T, gravity, inertia = self._body.pose(), self._body.gravity, self._inertia
        R, rates = T.rotation, np.array(self._body.rates())
        velocity = R @ np.array(self._body.velocity())
        wanted, yaw_rate = self._wanted_velocity(command, T, velocity, dt)
        # Force per mass in the world, within the limits of thrust and tilt.
        force: FloatArray = VELOCITY_GAIN * (wanted - velocity) + np.array((0.0, 0.0, gravity))
        force[2] = min(max(force[2], MIN_THRUST * gravity), self._max_thrust / self._mass)
        horizontal, most = math.hypot(force[0], force[1]), math.tan(MAX_TILT) * force[2]
        if horizontal > most:
            force[:2] *= most / horizontal
        up = R.T @ (force / np.linalg.norm(force))
        # The smallest turn from the body's z to the wanted direction, in the body's axes.
        error = np.array((-up[1], up[0], 0.0))
        turn = inertia * (ATTITUDE_GAIN * error + RATE_GAIN * (np.array((0.0, 0.0, yaw_rate)) - rates))
        torque = turn + np.cross(rates, inertia * rates)
        thrust = self._mass * float(force @ R[:, 2])
        thrusts = self._allocation @ np.array((max(thrust, 0.0), *torque))
        limited: FloatArray = np.clip(thrusts, 0.0, self._max_thrust / len(thrusts))
        return limited

    def _wanted_velocity(
        self, command: Twist | Waypoint, T: Pose3, velocity: FloatArray, dt: float
    ) -> tuple[FloatArray, float]:
        """Return the wanted velocity (3,) in the world, m/s, and the wanted yaw rate, rad/s."""
        robot = self.robot
        if isinstance(command, Waypoint):
            self._hold, self._v, self._omega = None, 0.0, 0.0
            return self._towards(command, T)
        if command.climb != 0.0:
            self._hold = None
            altitude = self._altitude + clip(command.climb, MAX_CLIMB_RATE) * dt
            self._altitude = min(max(altitude, MIN_ALTITUDE), MAX_ALTITUDE)
        v = clip(command.v, robot.max_speed)
        self._v += clip(v - self._v, robot.max_acceleration * dt)
        self._omega = clip(command.omega, robot.max_turn_rate)
        if v == 0.0 and self._omega == 0.0 and self._v == 0.0:
            self._hold = self._hold or Waypoint(T.x, T.y, self._height(T, velocity), T.yaw)
            return self._towards(self._hold, T)
        self._hold = None
        climb = 2 * POSITION_GAIN * (self._height(T, velocity) - T.z)
        wanted = np.array((self._v * math.cos(T.yaw), self._v * math.sin(T.yaw), 0.0))
        wanted[2] = clip(climb, MAX_CLIMB_RATE)
        return wanted, self._omega

    def _towards(self, goal: Waypoint, T: Pose3) -> tuple[FloatArray, float]:
        robot = self.robot
        wanted: FloatArray = POSITION_GAIN * (np.array((goal.x, goal.y, goal.z)) - T.position)
        horizontal = math.hypot(wanted[0], wanted[1])
        if horizontal > robot.max_speed:
            wanted[:2] *= robot.max_speed / horizontal
        wanted[2] = clip(float(wanted[2]), MAX_CLIMB_RATE)
        return wanted, clip(HEADING_GAIN * wrap_angle(goal.yaw - T.yaw), robot.max_turn_rate)

    def _height(self, T: Pose3, velocity: FloatArray) -> float:
        """Return the wanted height over the highest ground from here to the lookahead."""
        times = np.linspace(0.0, LOOKAHEAD, 9).tolist()
        ground = [float(self._surface.height_at(T.x + velocity[0] * t, T.y + velocity[1] * t)) for t in times]
        known = [z for z in ground if math.isfinite(z)]
        return max(known, default=T.z - self._altitude) + self._altitude


class FlightControllers:
    """Rotor thrusts of N quadrotors.

    Args:
        surfaces: Ground below each quadrotor; replaceable.
        waypoints: Pose that each quadrotor flies to instead of its command; None = the command.
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
        """Fill the thrusts, newtons (see `_drive`)."""
        for i in ids.tolist():
            command = self._waypoints[i] or Twist(*commands[i].tolist())
            ctrl[i] = self._controllers[i].update(command, dt)


MAX_UPDATES = 256
"""Number of control updates for which commands are remembered."""


class LateCommands:
    """Commands of N robots that take effect some control updates later.

    Attributes:
        updates: (N,) number of control updates until a command takes effect; less than `MAX_UPDATES`.
    """

    def __init__(self, count: int) -> None:
        self.updates = np.zeros(count, np.int64)
        self._commands = np.zeros((count, MAX_UPDATES, 3))
        self._turn = np.zeros(count, np.int64)

    def begin(self, k: int) -> None:
        """Forget the commands of robot `k`."""
        self._commands[k] = 0.0

    def delay(self, ids: IntArray, commands: FloatArray) -> FloatArray:
        """Return the commands (N, 3) that take effect in this control update of robots `ids`."""
        present, turns = np.zeros_like(commands), self._turn[ids]
        self._commands[ids, turns] = commands[ids]
        present[ids] = self._commands[ids, (turns - self.updates[ids]) % MAX_UPDATES]
        self._turn[ids] = (turns + 1) % MAX_UPDATES
        return present


def make_controllers(
    robot: Robot,
    actuators: Sequence[Sequence[int]],
    bodies: Sequence[BodyState],
    surfaces: Sequence[HeightField] = (),
    waypoints: Sequence[Waypoint | None] = (),
) -> DifferentialDrives | FlightControllers:
    """Return the controllers of robots (see `DifferentialDrives` and `FlightControllers`).

    `actuators` are those of the wheels on the left and on the right. Only flying robots need surfaces and
    waypoints.
    """
    if robot.flies:
        return FlightControllers(robot, bodies, surfaces, waypoints)
    left, right = (np.array(side, np.int64) for side in actuators)
    return DifferentialDrives(robot, (left, right), len(bodies))
