"""What is refused before MuJoCo is entered: one clear sentence each."""

from __future__ import annotations

import math
from dataclasses import astuple

from lirs_envs.robots import Robot
from lirs_envs.sensors import Noise
from lirs_envs.twist import Twist, Waypoint
from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2
from lirs_wct.world import World


def check_arguments(world: object, robot: object, seed: object, noise: object) -> None:
    """Check what a simulation is made of.

    Raises:
        ConfigError: one is of the wrong type, or the robot is larger than the world.
    """
    for name, value, kind in (
        ("world", world, World),
        ("robot", robot, Robot),
        ("seed", seed, int),
        ("noise", noise, Noise),
    ):
        if not isinstance(value, kind):
            raise ConfigError(f"a simulation's {name} must be a {kind.__name__}, got {value!r}")
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
    if not all(isinstance(value, float | int) and math.isfinite(value) for value in astuple(command)):
        raise ConfigError(f"a command must be finite, got {command}")


def check_start(start: object) -> None:
    """Check a start pose.

    Raises:
        ConfigError: it is neither a Pose2 nor None.
    """
    if start is not None and not isinstance(start, Pose2):
        raise ConfigError(f"a start must be a Pose2 or None, got {start!r}")
