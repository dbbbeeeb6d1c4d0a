"""The robots as data: one MJCF file under `assets/` and one row here each.

Required contents of a robot's MJCF file:

* its options (timestep, solver) and a camera `chase`;
* a body `base_link` with a free joint and `sleep="never"`;
* a velocity actuator for each driven wheel with the name of its joint, or a thrust actuator for each rotor;
* the sensor `accelerometer` on the base;
* contact geoms with `priority="1"`, so that the robot's friction holds on every ground; casters that roll on
  it are named `..._caster`.
"""

from __future__ import annotations

import math

from lirs_envs.robots.robot import Robot
from lirs_wct.errors import unknown_name
from lirs_wct.geometry import Pose3

ROBOTS: dict[str, Robot] = {
    robot.name: robot
    for robot in (
        Robot(
            name="husky",
            left_wheels=("front_left_wheel", "rear_left_wheel"),
            right_wheels=("front_right_wheel", "rear_right_wheel"),
            wheel_radius=0.1651,
            wheelbase=0.512,
            track=0.5708,
            base_height=0.13228,
            radius=0.58,
            max_speed=1.0,
            max_turn_rate=2.0,
            max_acceleration=3.0,
            max_turn_acceleration=6.0,
            max_slope=math.radians(25),
            friction=0.7,
            lidar="lms111",
            T_base_laser=Pose3(0.2206, 0.0, 0.32),
        ),
        Robot(
            name="jackal",
            left_wheels=("front_left_wheel", "rear_left_wheel"),
            right_wheels=("front_right_wheel", "rear_right_wheel"),
            wheel_radius=0.098,
            wheelbase=0.262,
            track=0.37559,
            base_height=0.0635,
            radius=0.31,
            max_speed=2.0,
            max_turn_rate=4.0,
            max_acceleration=20.0,
            max_turn_acceleration=25.0,
            max_slope=math.radians(30),
            friction=1.25,
            lidar="utm30lx",
            T_base_laser=Pose3(0.12, 0.0, 0.28),
        ),
        Robot(
            name="turtlebot2",
            left_wheels=("left_wheel",),
            right_wheels=("right_wheel",),
            wheel_radius=0.035,
            track=0.230,
            base_height=0.0102,
            radius=0.18,
            max_speed=0.8,
            max_turn_rate=5.4,
            max_acceleration=1.0,
            max_turn_acceleration=2.0,
            max_slope=math.radians(10),
            friction=0.5,
            lidar="urg04lx",
            T_base_laser=Pose3(0.08, 0.0, 0.30),
        ),
        Robot(
            name="turtlebot3_burger",
            left_wheels=("left_wheel",),
            right_wheels=("right_wheel",),
            wheel_radius=0.033,
            track=0.160,
            base_height=0.010,
            radius=0.14,
            max_speed=0.22,
            max_turn_rate=2.84,
            max_acceleration=1.0,
            # No published figure: the wheels speed up as fast as they do straight ahead.
            max_turn_acceleration=1.0 / 0.080,
            max_slope=math.radians(10),
            friction=0.6,
            lidar="lds01",
            T_base_laser=Pose3(-0.032, 0.0, 0.17),
        ),
        Robot(
            name="turtlebot3_waffle",
            left_wheels=("left_wheel",),
            right_wheels=("right_wheel",),
            wheel_radius=0.033,
            track=0.287,
            base_height=0.010,
            radius=0.26,
            max_speed=0.26,
            max_turn_rate=1.82,
            max_acceleration=1.0,
            max_turn_acceleration=1.0 / 0.1435,
            max_slope=math.radians(10),
            friction=0.6,
            lidar="lds01",
            T_base_laser=Pose3(-0.064, 0.0, 0.12),
        ),
        Robot(
            name="quadrotor",
            rotors=("front_rotor", "left_rotor", "rear_rotor", "right_rotor"),
            # Initial height, and height above the terrain.
            base_height=1.0,
            radius=0.43,
            max_speed=10.0,
            # No published figures: a usual turn rate, and the acceleration at a tilt of 45 deg.
            max_turn_rate=3.0,
            max_acceleration=9.81,
            max_turn_acceleration=10.0,
            max_slope=math.radians(45),
            friction=0.6,
            lidar="utm30lx",
            T_base_laser=Pose3(0.0, 0.0, -0.10),
        ),
    )
}
"""Robots by name."""


def make_robot(name: str) -> Robot:
    """Return a robot by its name.

    Raises:
        ConfigError: no robot has this name; the message lists them.
    """
    if not isinstance(name, str) or name not in ROBOTS:
        raise unknown_name("robot", name, ROBOTS)
    return ROBOTS[name]
