"""What a robot can be told to do."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Twist:
    """A commanded motion of the base.

    Attributes:
        v: speed ahead, m/s.
        omega: turn rate, rad/s, counter-clockwise.
    """

    v: float = 0.0
    omega: float = 0.0


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A place in the world to fly to and stay at; only for robots that fly. Metres and radians."""

    x: float
    y: float
    z: float
    yaw: float = 0.0
