"""What is refused before MuJoCo is entered: one clear sentence each."""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np

from lirs_envs.robots.command import Twist, Waypoint
from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.sensors import SensorNoise
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World


def check_arguments(world: object, robot: object, seed: object, noise: object) -> None:
    """Check what a simulation is made of.

    Raises:
        ConfigError: one is of the wrong type, or the robot is larger than the world.
    """
    for name, value, kind in (
        ("world", world, World),
        ("robot", robot, Robot),
        ("noise", noise, SensorNoise),
    ):
        if not isinstance(value, kind):
            raise ConfigError(f"a simulation's {name} must be a {kind.__name__}, got {value!r}")
    check_seed(seed)
    assert isinstance(world, World) and isinstance(robot, Robot)  # noqa: PT018  for mypy
    if min(world.surface.size) < 2 * robot.radius:
        width, depth = world.surface.size
        raise ConfigError(
            f"{robot.name} is {2 * robot.radius:g} m wide: "
            f"too large for {world.name!r} of {width:g} x {depth:g} m"
        )


def check_command(robot: Robot, command: object) -> None:
    """Check a command.

    Raises:
        ConfigError: it is no command, none for this robot, or not finite.
    """
    if isinstance(command, Waypoint) and not robot.flies:
        raise ConfigError(f"{robot.name} drives: it takes a Twist, got {command}")
    if not isinstance(command, Twist | Waypoint):
        raise ConfigError(f"a command must be a Twist or a Waypoint, got {command!r}")
    if not all(_finite(value) for value in astuple(command)):
        raise ConfigError(f"a command must be finite, got {command}")


def check_start(start: object) -> None:
    """Check a start pose.

    Raises:
        ConfigError: it is neither a Pose2 nor None, or not finite.
    """
    if start is None:
        return
    if not isinstance(start, Pose2):
        raise ConfigError(f"a start must be a Pose2 or None, got {start!r}")
    if not all(_finite(value) for value in (start.x, start.y, start.yaw)):
        raise ConfigError(f"a start pose must be finite, got {start}")


def check_seed(seed: object) -> None:
    """Check a seed.

    Raises:
        ConfigError: it is no whole number from 0 up.
    """
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool):
        raise ConfigError(f"a simulation's seed must be a int, got {seed!r}")
    if seed < 0:
        raise ConfigError(f"seed must be 0 or above, got {seed}")


def _finite(value: object) -> bool:
    return isinstance(value, float | int | np.floating | np.integer) and math.isfinite(value)
