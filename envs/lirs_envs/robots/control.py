"""State and control of a robot: driven wheels or rotors from commanded twists.

The flight control is the cascade of the Hector quadrotor (Meyer et al., "Comprehensive simulation of
quadrotor UAVs using ROS and Gazebo", SIMPAR 2012). Position gives a wanted velocity, velocity a wanted
acceleration, which is a thrust and a tilt. The attitude loop gives torques. The control reads the true state,
like Hector's default.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np

from lirs_envs.robots.robot import Robot, Twist, Waypoint, clip
from lirs_wct.arrays import FloatArray, IntArray, RecordArray, Vector3, njit
from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import HeightField, Pose3, wrap_angle


class BodyState:
    """True state of one robot in the world frame, for its sensors and control.

    From positions and velocities: MuJoCo's sensors lie one step behind them.

    Attributes:
        model: Compiled model.
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


@dataclass(frozen=True, kw_only=True)
class DriveConfig(Checked, of="the yaw loop"):
    """Gains of the yaw loop, which corrects the error of the feed-forward.

    Attributes:
        proportional: Extra turn rate per rad/s of error.
        integral: Extra turn rate per radian of error.
        integral_limit: Largest integral part, rad/s.
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

    Attributes:
        update: Function that fills the controls, wheel speeds in rad/s (see `_drive`).
    """

    update: Callable[[IntArray, FloatArray, FloatArray, float, FloatArray], None]

    def __init__(self, robot: Robot, actuators: WheelActuators, count: int) -> None:
        config = DriveConfig()
        figures = [getattr(robot, name) for name in LIMITS] + [getattr(config, name) for name in GAINS]
        self._state = np.zeros((count, 3))
        # No method: a call of one takes as long as the kernel.
        self.update = partial(_drive, np.array([tuple(figures)], DRIVE), actuators, self._state)

    def begin(self, i: int) -> None:
        """Reset the control of robot `i` at rest."""
        self._state[i] = 0.0


@njit
def _drive(
    parameters: RecordArray,
    actuators: WheelActuators,
    state: FloatArray,
    ids: IntArray,
    commands: FloatArray,
    rates: FloatArray,
    dt: float,
    ctrl: FloatArray,
) -> None:
    """Fill the controls (N, nu) to hold for `dt` seconds.

    Args:
        parameters: (1,) limits and gains of `DRIVE`.
        actuators: Driven wheels.
        state: (N, 3) states of `wheel_speeds`.
        ids: Rows of the robots.
        commands: (N, 3) speeds, m/s, turn rates, rad/s, climbs, m/s; clipped to the robot's limits.
        rates: (N, 3) rates measured by the gyro, rad/s.
        dt: Seconds.
        ctrl: (N, nu) controls.
    """
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
        v: Commanded speed, m/s.
        omega: Commanded turn rate, rad/s.
        yaw_rate: Rate measured by the gyro, rad/s.
        dt: Seconds until the next update.
        parameters: (1,) limits and gains of `DRIVE`.
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


MIN_THRUST = 0.3
"""Least vertical thrust as a share of the weight: a body in free fall cannot turn."""


@dataclass(frozen=True, kw_only=True)
class FlightConfig(Checked, of="the flight control"):
    """Gains and limits of the flight control.

    Attributes:
        position_gain: Wanted speed a meter of error, 1/s.
        velocity_gain: Wanted acceleration a m/s of error, 1/s.
        attitude_gain: Angular acceleration a radian of error, 1/s^2.
        rate_gain: Angular acceleration a rad/s of error, 1/s.
        heading_gain: Wanted yaw rate a radian of error, 1/s.
        max_tilt: Largest tilt, radians.
        max_climb_rate: Largest vertical speed, m/s.
        altitude: Height above the ground in terrain following, meters; a climb changes it.
        min_altitude: Lowest altitude after a climb, meters.
        max_altitude: Highest altitude after a climb, meters.
        lookahead: Time ahead over which the ground counts in terrain following, seconds.
    """

    position_gain: float = limited(1.5, "(0, inf)")
    velocity_gain: float = limited(5.0, "(0, inf)")
    attitude_gain: float = limited(220.0, "(0, inf)")
    rate_gain: float = limited(24.0, "(0, inf)")
    heading_gain: float = limited(2.0, "(0, inf)")
    max_tilt: float = limited(math.radians(45), "(0, inf)")
    max_climb_rate: float = limited(5.0, "(0, inf)")
    altitude: float = limited(1.0, "(0, inf)")
    min_altitude: float = limited(0.6, "(0, inf)")
    max_altitude: float = limited(10.0, "(0, inf)")
    lookahead: float = limited(0.8, "(0, inf)")


class QuadrotorController:
    """Rotor thrusts from commands.

    A `Twist` flies ahead and turns at an altitude above the highest ground within the lookahead. The altitude
    begins at the config's value, and a climb changes it. Without motion the robot holds its position. A
    `Waypoint` is a pose to fly to and hold.
    """

    def __init__(self, robot: Robot, body: BodyState, surface: HeightField) -> None:
        self.robot, self.config = robot, FlightConfig()
        self._body, self._surface = body, surface
        self._read_airframe(body.model)
        self._hold: Waypoint | None = None
        self._v = self._omega = 0.0
        self._altitude = self.config.altitude

    def _read_airframe(self, model: mujoco.MjModel) -> None:
        """Read mass, inertia about the body's axes, rotors and their greatest common thrust."""
        base = model.body("base_link")
        self._mass, self._inertia = float(base.mass[0]), np.array(base.inertia)
        ids = [model.actuator(name).id for name in self.robot.rotors]
        sites = model.site_pos[model.actuator_trnid[ids, 0]]
        drag = model.actuator_gear[ids, 5]
        # One newton along z at (x, y): torque (y, -x, drag).
        wrench = np.stack((np.ones(len(ids)), sites[:, 1], -sites[:, 0], drag), axis=1)
        self._allocation = np.linalg.pinv(wrench.T)
        self._max_thrust = float(model.actuator_ctrlrange[ids, 1].sum())

    def update(self, command: Twist | Waypoint, dt: float) -> FloatArray:
        """Return the thrust (rotors,) of each rotor for `dt` seconds, newtons."""
        T = self._body.pose()
        R = T.rotation
        velocity = R @ np.array(self._body.velocity())
        wanted, wanted_yaw_rate = self._wanted_velocity(command, T, velocity, dt)
        force = self._specific_force(wanted - velocity)
        torque = self._torque(R, force, wanted_yaw_rate, np.array(self._body.rates()))
        thrust = self._mass * float(force @ R[:, 2])
        thrusts = self._allocation @ np.array((max(thrust, 0.0), *torque))
        limited: FloatArray = np.clip(thrusts, 0.0, self._max_thrust / len(thrusts))
        return limited

    def _specific_force(self, velocity_error: FloatArray) -> FloatArray:
        """Return the wanted force (3,) per mass in the world, m/s^2, limited.

        The limits are those of thrust and tilt.
        """
        gravity = self._body.gravity
        force: FloatArray = self.config.velocity_gain * velocity_error + np.array((0.0, 0.0, gravity))
        force[2] = min(max(force[2], MIN_THRUST * gravity), self._max_thrust / self._mass)
        horizontal, most = math.hypot(force[0], force[1]), math.tan(self.config.max_tilt) * force[2]
        if horizontal > most:
            force[:2] *= most / horizontal
        return force

    def _torque(self, R: FloatArray, force: FloatArray, yaw_rate: float, rates: FloatArray) -> FloatArray:
        """Return the torque (3,) toward the wanted thrust direction and yaw rate."""
        config, inertia = self.config, self._inertia
        up = R.T @ (force / np.linalg.norm(force))
        # The smallest turn from the body's z to the wanted direction, in the body's axes.
        error = np.array((-up[1], up[0], 0.0))
        wanted = np.array((0.0, 0.0, yaw_rate))
        turn: FloatArray = inertia * (config.attitude_gain * error + config.rate_gain * (wanted - rates))
        return turn + np.cross(rates, inertia * rates)

    def _wanted_velocity(
        self, command: Twist | Waypoint, T: Pose3, velocity: FloatArray, dt: float
    ) -> tuple[FloatArray, float]:
        """Return the wanted velocity (3,) in the world, m/s, and the wanted yaw rate, rad/s."""
        robot, config = self.robot, self.config
        if isinstance(command, Waypoint):
            self._hold, self._v, self._omega = None, 0.0, 0.0
            return self._towards(command, T)
        if command.climb != 0.0:
            self._hold = None
            altitude = self._altitude + clip(command.climb, config.max_climb_rate) * dt
            self._altitude = min(max(altitude, config.min_altitude), config.max_altitude)
        v = clip(command.v, robot.max_speed)
        self._v += clip(v - self._v, robot.max_acceleration * dt)
        self._omega = clip(command.omega, robot.max_turn_rate)
        if v == 0.0 and self._omega == 0.0 and self._v == 0.0:
            self._hold = self._hold or Waypoint(T.x, T.y, self._height(T, velocity), T.yaw)
            return self._towards(self._hold, T)
        self._hold = None
        climb = 2 * config.position_gain * (self._height(T, velocity) - T.z)
        wanted = np.array((self._v * math.cos(T.yaw), self._v * math.sin(T.yaw), 0.0))
        wanted[2] = clip(climb, config.max_climb_rate)
        return wanted, self._omega

    def _towards(self, goal: Waypoint, T: Pose3) -> tuple[FloatArray, float]:
        config, robot = self.config, self.robot
        wanted: FloatArray = config.position_gain * (np.array((goal.x, goal.y, goal.z)) - T.position)
        horizontal = math.hypot(wanted[0], wanted[1])
        if horizontal > robot.max_speed:
            wanted[:2] *= robot.max_speed / horizontal
        wanted[2] = clip(float(wanted[2]), config.max_climb_rate)
        return wanted, clip(config.heading_gain * wrap_angle(goal.yaw - T.yaw), robot.max_turn_rate)

    def _height(self, T: Pose3, velocity: FloatArray) -> float:
        """Return the wanted height over the highest ground from here to the lookahead."""
        times = np.linspace(0.0, self.config.lookahead, 9).tolist()
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
