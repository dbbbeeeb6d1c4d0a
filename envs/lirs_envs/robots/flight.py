"""Flight control of a quadrotor: a cascade from position over velocity and attitude to rotor thrusts.

The cascade of the Hector quadrotor (Meyer et al., "Comprehensive simulation of quadrotor UAVs using ROS and
Gazebo", SIMPAR 2012): position gives a wanted velocity, velocity a wanted acceleration, which is a
thrust and a tilt; the attitude loop gives torques. It reads the true state, as Hector's does by default.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from lirs_envs.model import RobotModel
from lirs_envs.robots.command import Twist, Waypoint
from lirs_envs.robots.robot import Robot
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose3, wrap_angle

GRAVITY = 9.81
Ground = Callable[[float, float], float]
"""Height of the ground at x, y; NaN beyond the world."""


@dataclass(frozen=True, kw_only=True)
class FlightConfig:
    """Gains and limits.

    Attributes:
        position: wanted speed a metre of error, 1/s.
        velocity: wanted acceleration a m/s of error, 1/s.
        attitude: angular acceleration a radian of error, 1/s^2.
        rate: angular acceleration a rad/s of error, 1/s.
        heading: wanted yaw rate a radian of error, 1/s.
        tilt: largest, radians.
        climb: largest vertical speed, m/s.
        altitude: above the ground while it follows the terrain, metres.
        foresight: seconds ahead in which the ground counts.

    Raises:
        ConfigError: a figure is not above 0.
    """

    position: float = 1.5
    velocity: float = 5.0
    attitude: float = 220.0
    rate: float = 24.0
    heading: float = 2.0
    tilt: float = math.radians(45)
    climb: float = 5.0
    altitude: float = 1.0
    foresight: float = 0.8

    def __post_init__(self) -> None:
        for item in fields(self):
            if not 0 < getattr(self, item.name) < math.inf:
                raise ConfigError(
                    f"flight: {item.name} must be a finite number above 0, got {getattr(self, item.name)}"
                )


@dataclass(frozen=True)
class Airframe:
    """What the control knows of the body: mass, inertia (3,), and each rotor's thrust and torque (n, 4).

    A row of `wrench` is thrust along z and torque about x, y, z for one newton of that rotor.
    """

    mass: float
    inertia: FloatArray
    wrench: FloatArray
    thrust: float


class QuadrotorController:
    """Flies a simulated robot: the control, fed with the state of its body."""

    def __init__(self, robot: Robot, body: RobotModel, surface: HeightField) -> None:
        model = body.model
        base = model.body("base_link")
        ids = [model.actuator(name).id for name in robot.rotors]
        sites = model.site_pos[model.actuator_trnid[ids, 0]]
        drag = model.actuator_gear[ids, 5]
        # One newton along z at (x, y): torque (y, -x, drag).
        wrench = np.stack((np.ones(len(ids)), sites[:, 1], -sites[:, 0], drag), axis=1)
        thrust = float(model.actuator_ctrlrange[ids, 1].sum())
        frame = Airframe(float(base.mass[0]), np.array(base.inertia), wrench, thrust)
        self._control = _Cascade(robot, frame, lambda x, y: float(surface.height_at(x, y)))
        self._body = body

    def update(self, command: Twist | Waypoint, yaw_rate: float, dt: float) -> tuple[float, ...]:
        """Return the thrusts to hold for `dt` seconds."""
        T, velocity = self._body.pose(), np.array(self._body.velocity())
        return self._control.update(command, T, T.rotation @ velocity, np.array(self._body.rates()), dt)


class _Cascade:
    """Rotor thrusts from commands.

    A `Twist` flies ahead and turns at the altitude of the config above the highest ground that comes within
    the foresight; without any motion it holds its place. A `Waypoint` flies there and stays.
    """

    def __init__(
        self, robot: Robot, frame: Airframe, ground: Ground, config: FlightConfig | None = None
    ) -> None:
        self.robot = robot
        self.config = config or FlightConfig()
        self._frame = frame
        self._ground = ground
        self._mix = np.linalg.pinv(frame.wrench.T)
        self._hold: Waypoint | None = None
        self._v = self._omega = 0.0

    def update(
        self, command: Twist | Waypoint, T: Pose3, velocity: FloatArray, rates: FloatArray, dt: float
    ) -> tuple[float, ...]:
        """Return the thrust of each rotor, newtons.

        Args:
            command: beyond the robot's limits it is clipped.
            T: `T_world_base`.
            velocity: (3,) in the world, m/s.
            rates: (3,) of the body about its axes, rad/s.
            dt: time for which the thrusts will hold, seconds.
        """
        wanted, yaw_rate = self._wanted_velocity(command, T, velocity, dt)
        force = self.config.velocity * (wanted - velocity) + np.array((0.0, 0.0, GRAVITY))
        force[2] = min(max(force[2], 0.3 * GRAVITY), self._frame.thrust / self._frame.mass)
        across, most = math.hypot(force[0], force[1]), math.tan(self.config.tilt) * force[2]
        if across > most:
            force[:2] *= most / across
        R = T.rotation
        torque = self._torque(R, force, yaw_rate, rates)
        lift = self._frame.mass * float(force @ R[:, 2])
        thrusts = self._mix @ np.array((max(lift, 0.0), *torque))
        each = self._frame.thrust / len(thrusts)
        return tuple(np.clip(thrusts, 0.0, each).tolist())

    def _torque(self, R: FloatArray, force: FloatArray, yaw_rate: float, rates: FloatArray) -> FloatArray:
        """Turn the body's z towards the force, and about it at the wanted rate."""
        config = self.config
        up = R.T @ (force / np.linalg.norm(force))
        # The smallest turn from the body's z to the wanted direction, in the body's axes.
        error = np.array((-up[1], up[0], 0.0))
        wanted = np.array((0.0, 0.0, yaw_rate))
        gain = config.rate * (wanted - rates)
        turn: FloatArray = self._frame.inertia * (config.attitude * error + gain)
        return turn + np.cross(rates, self._frame.inertia * rates)

    def _wanted_velocity(
        self, command: Twist | Waypoint, T: Pose3, velocity: FloatArray, dt: float
    ) -> tuple[FloatArray, float]:
        robot, config = self.robot, self.config
        if isinstance(command, Waypoint):
            self._hold, self._v, self._omega = None, 0.0, 0.0
            return self._towards(command, T)
        v = _clip(command.v, robot.max_speed)
        self._v += _clip(v - self._v, robot.max_acceleration * dt)
        self._omega = _clip(command.omega, robot.max_turn_rate)
        if v == 0.0 and self._omega == 0.0 and self._v == 0.0:
            self._hold = self._hold or Waypoint(T.x, T.y, self._height(T, velocity), T.yaw)
            return self._towards(self._hold, T)
        self._hold = None
        climb = 2 * config.position * (self._height(T, velocity) - T.z)
        ahead = np.array((self._v * math.cos(T.yaw), self._v * math.sin(T.yaw), 0.0))
        ahead[2] = _clip(climb, config.climb)
        return ahead, self._omega

    def _towards(self, goal: Waypoint, T: Pose3) -> tuple[FloatArray, float]:
        wanted = self.config.position * (np.array((goal.x, goal.y, goal.z)) - T.position)
        across = math.hypot(wanted[0], wanted[1])
        if across > self.robot.max_speed:
            wanted[:2] *= self.robot.max_speed / across
        wanted[2] = _clip(float(wanted[2]), self.config.climb)
        yaw_rate = _clip(self.config.heading * wrap_angle(goal.yaw - T.yaw), self.robot.max_turn_rate)
        return wanted, yaw_rate

    def _height(self, T: Pose3, velocity: FloatArray) -> float:
        """Return the wanted height over the highest ground from here to the foresight ahead."""
        steps = np.linspace(0.0, self.config.foresight, 9)
        found = [self._ground(T.x + velocity[0] * t, T.y + velocity[1] * t) for t in steps.tolist()]
        known = [z for z in found if math.isfinite(z)]
        return max(known, default=T.z - self.config.altitude) + self.config.altitude


def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
