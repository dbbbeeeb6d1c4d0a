"""Flight control of a quadrotor: cascade from position to velocity, attitude and rotor thrusts.

The cascade is that of the Hector quadrotor (Meyer et al., "Comprehensive simulation of quadrotor UAVs using
ROS and Gazebo", SIMPAR 2012). Position gives a wanted velocity, velocity a wanted acceleration, which is a
thrust and a tilt. The attitude loop gives torques. The control reads the true state, like Hector's default.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from lirs_envs.robots.body_state import BodyState
from lirs_envs.robots.robot import Robot, Twist, Waypoint, clip
from lirs_wct import HeightField, Pose3, wrap_angle
from lirs_wct.arrays import FloatArray
from lirs_wct.checks import Checked, limited

LEAST_THRUST = 0.3
"""Least vertical thrust as a share of the weight: a body in free fall cannot turn."""


@dataclass(frozen=True, kw_only=True)
class FlightConfig(Checked, of="the flight control"):
    """Gains and limits of the flight control.

    Attributes:
        position_gain: wanted speed a meter of error, 1/s.
        velocity_gain: wanted acceleration a m/s of error, 1/s.
        attitude_gain: angular acceleration a radian of error, 1/s^2.
        rate_gain: angular acceleration a rad/s of error, 1/s.
        heading_gain: wanted yaw rate a radian of error, 1/s.
        max_tilt: largest tilt, radians.
        max_climb_rate: largest vertical speed, m/s.
        altitude: height above the ground in terrain following, meters; a climb changes it.
        min_altitude: lowest that a climb makes it, meters.
        max_altitude: highest that a climb makes it, meters.
        lookahead: time ahead over which the ground counts in terrain following, seconds.
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


@dataclass(frozen=True)
class Airframe:
    """Mechanics of a quadrotor's body.

    Attributes:
        mass: kg.
        inertia: (3,) about the body's axes, kg m^2.
        wrench: (rotors, 4) thrust along z and torque about x, y, z for one newton of each rotor.
        max_thrust: greatest thrust of all rotors together, newtons.
    """

    mass: float
    inertia: FloatArray
    wrench: FloatArray
    max_thrust: float

    @classmethod
    def of(cls, robot: Robot, model: mujoco.MjModel) -> Airframe:
        """Read the airframe of a robot from its compiled model."""
        base = model.body("base_link")
        ids = [model.actuator(name).id for name in robot.rotors]
        sites = model.site_pos[model.actuator_trnid[ids, 0]]
        drag = model.actuator_gear[ids, 5]
        # One newton along z at (x, y): torque (y, -x, drag).
        wrench = np.stack((np.ones(len(ids)), sites[:, 1], -sites[:, 0], drag), axis=1)
        max_thrust = float(model.actuator_ctrlrange[ids, 1].sum())
        return cls(float(base.mass[0]), np.array(base.inertia), wrench, max_thrust)


class QuadrotorController:
    """Rotor thrusts from commands.

    A `Twist` flies ahead and turns at an altitude above the highest ground within the lookahead. The altitude
    begins at the config's value, and a climb changes it. Without motion the robot holds its position. A
    `Waypoint` is a pose to fly to and hold.
    """

    def __init__(self, robot: Robot, body: BodyState, surface: HeightField) -> None:
        self.robot, self.config = robot, FlightConfig()
        self._body = body
        self._surface = surface
        self._gravity = body.gravity
        self._airframe = Airframe.of(robot, body.model)
        self._allocation = np.linalg.pinv(self._airframe.wrench.T)
        self._hold: Waypoint | None = None
        self._v = self._omega = 0.0
        self._altitude = self.config.altitude

    def update(self, command: Twist | Waypoint, dt: float) -> FloatArray:
        """Return the thrust (rotors,) of each rotor for `dt` seconds, newtons."""
        T = self._body.pose()
        R = T.rotation
        velocity = R @ np.array(self._body.velocity())
        wanted, wanted_yaw_rate = self._wanted_velocity(command, T, velocity, dt)
        force = self._specific_force(wanted - velocity)
        torque = self._torque(R, force, wanted_yaw_rate, np.array(self._body.rates()))
        thrust = self._airframe.mass * float(force @ R[:, 2])
        thrusts = self._allocation @ np.array((max(thrust, 0.0), *torque))
        limited: FloatArray = np.clip(thrusts, 0.0, self._airframe.max_thrust / len(thrusts))
        return limited

    def _specific_force(self, velocity_error: FloatArray) -> FloatArray:
        """Return the wanted force (3,) per mass in the world, m/s^2, limited.

        The limits are those of thrust and tilt.
        """
        force: FloatArray = self.config.velocity_gain * velocity_error + np.array((0.0, 0.0, self._gravity))
        force[2] = min(
            max(force[2], LEAST_THRUST * self._gravity), self._airframe.max_thrust / self._airframe.mass
        )
        horizontal, most = math.hypot(force[0], force[1]), math.tan(self.config.max_tilt) * force[2]
        if horizontal > most:
            force[:2] *= most / horizontal
        return force

    def _torque(self, R: FloatArray, force: FloatArray, yaw_rate: float, rates: FloatArray) -> FloatArray:
        """Return the torque (3,) toward the wanted thrust direction and yaw rate."""
        config, inertia = self.config, self._airframe.inertia
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
