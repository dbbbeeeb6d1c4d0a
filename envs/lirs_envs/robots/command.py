"""Commands to a robot."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_envs.robots.robot import Robot
from lirs_wct.errors import ConfigError
from lirs_wct.field_validators import is_finite


@dataclass(frozen=True, slots=True)
class Twist:
    """Commanded velocity of the base.

    Attributes:
        v: forward speed, m/s.
        omega: turn rate, rad/s, counter-clockwise.
        climb: change of a flying robot's height above the ground, m/s.
    """

    v: float = 0.0
    omega: float = 0.0
    climb: float = 0.0


@dataclass(frozen=True, slots=True)
class Waypoint:
    """Pose in the world to fly to and hold; only for robots that fly. Meters and radians."""

    x: float
    y: float
    z: float
    yaw: float = 0.0


def check_command(robot: Robot, command: object) -> None:
    """Check a command.

    Raises:
        ConfigError: it is no command, none for this robot, or not finite.
    """
    if isinstance(command, Waypoint) and not robot.flies:
        raise ConfigError(f"{robot.name} drives: it takes a Twist, got {command}")
    if not isinstance(command, Twist | Waypoint):
        raise ConfigError(f"a command must be a Twist or a Waypoint, got {command!r}")
    c = command
    if not all(map(is_finite, (c.v, c.omega, c.climb) if isinstance(c, Twist) else (c.x, c.y, c.z, c.yaw))):
        raise ConfigError(f"a command must be finite, got {command}")


def clip(value: float, limit: float) -> float:
    """Return a value limited to [-limit, limit]."""
    return max(-limit, min(limit, value))
