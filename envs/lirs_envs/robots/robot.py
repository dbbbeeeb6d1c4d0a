"""Robots as data: one MJCF file under `assets/` and a part of `lirs_wct/robots.toml` each.

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
import tomllib
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

from lirs_wct.display import html_table
from lirs_wct.errors import ConfigError, require_known, require_within
from lirs_wct.geometry import Pose3

ASSETS = Path(__file__).parent / "assets"
POSITIVE = (
    "base_height",
    "radius",
    "max_speed",
    "max_turn_rate",
    "max_acceleration",
    "max_turn_acceleration",
    "max_slope",
    "friction",
)
"""Fields above 0 that every robot has."""


@dataclass(frozen=True, kw_only=True)
class Robot:
    """Figures of a robot, which has driven wheels on both sides or rotors.

    Attributes:
        name: how users call it; its MJCF file is `assets/NAME.xml`.
        left_wheels: joints (and actuators) of the driven wheels on the left.
        right_wheels: Joints (and actuators) of the driven wheels on the right.
        wheel_radius: loaded, meters.
        wheelbase: between front and rear driven axle, meters; 0 = one driven axle (differential drive).
        track: between left and right wheels, meters.
        rotors: actuators (thrust, newtons) of a flying robot instead of wheels.
        base_height: base_link above level ground, meters; of a flying robot, when it starts.
        radius: radius of the circle around base_link that contains the robot, meters.
        max_speed: meters a second.
        max_turn_rate: rad/s.
        max_acceleration: m/s^2.
        max_turn_acceleration: rad/s^2.
        max_slope: steepest ground for start poses and planned paths, radians.
        friction: sliding friction of all its contact geoms but casters.
        lidar: name of its lidar preset.
        T_base_laser: mount of the lidar, such that the body is never in the way.

    Raises:
        ConfigError: a value is not legal.
    """

    name: str
    left_wheels: tuple[str, ...] = ()
    right_wheels: tuple[str, ...] = ()
    wheel_radius: float = 0.0
    wheelbase: float = 0.0
    track: float = 0.0
    rotors: tuple[str, ...] = ()
    base_height: float
    radius: float
    max_speed: float
    max_turn_rate: float
    max_acceleration: float
    max_turn_acceleration: float
    max_slope: float
    friction: float
    lidar: str
    T_base_laser: Pose3 = field(default_factory=Pose3)

    def __post_init__(self) -> None:
        wheels = bool(self.left_wheels) and bool(self.right_wheels)
        if wheels == self.flies or bool(self.left_wheels) != bool(self.right_wheels):
            raise ConfigError(f"robot {self.name!r} needs driven wheels on both sides, or rotors")
        of = f"robot {self.name!r}"
        positive = POSITIVE if self.flies else (*POSITIVE, "wheel_radius", "track")
        require_within(self, "(0, inf)", *positive, of=of)
        require_within(self, "[0, inf)", "wheelbase", of=of, unit="m")

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, radius {self.radius:g} m, {self.max_speed:g} m/s, lidar {self.lidar!r})"

    def _repr_html_(self) -> str:
        x, y, z = self.T_base_laser.position
        count = len(self.left_wheels) + len(self.right_wheels)
        wheels = f"{count} driven wheels, radius {self.wheel_radius:g} m, track {self.track:g} m"
        rows = [
            ("robot", self.name),
            ("moves by", f"{len(self.rotors)} rotors" if self.flies else wheels),
            ("radius", f"{self.radius:g} m"),
            ("top speed", f"{self.max_speed:g} m/s"),
            ("top turn rate", f"{self.max_turn_rate:g} rad/s"),
            ("steepest ground", f"{math.degrees(self.max_slope):.3g} deg"),
            ("lidar", f"{self.lidar} at ({x:g}, {y:g}, {z:g}) m"),
        ]
        return html_table(rows)

    @property
    def flies(self) -> bool:
        """Whether it has rotors instead of wheels."""
        return bool(self.rotors)

    @property
    def mjcf(self) -> Path:
        """The robot's MJCF file."""
        return ASSETS / f"{self.name}.xml"

    @property
    def skid_factor(self) -> float:
        """Wheel speed difference over `track` times yaw rate while all wheels slide or roll.

        On the spot a wheel slides sideways at wheelbase / 2 times the yaw rate. Dry friction opposes the
        slip's direction. The moments of its two parts cancel where slip ahead / slip sideways =
        wheelbase / track. Hence the factor is 1 + (wheelbase / track)^2 for any friction: 1.80 for a Husky,
        for which its makers use 1.875. It is 1 for a single driven axle, and without wheels.
        """
        return 1 + (self.wheelbase / self.track) ** 2 if self.wheelbase else 1.0


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


def clip(value: float, limit: float) -> float:
    """Return a value limited to [-limit, limit]."""
    return max(-limit, min(limit, value))


def _read_robot(name: str, figures: dict[str, Any]) -> Robot:
    """Return a robot from its figures in `robots.toml`."""
    fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in figures.items()}
    fields["max_slope"] = math.radians(figures["max_slope"])
    fields["T_base_laser"] = Pose3(*figures["T_base_laser"])
    return Robot(name=name, **fields)


FIGURES = tomllib.loads(files("lirs_wct").joinpath("robots.toml").read_text(encoding="utf-8"))
ROBOTS = {name: _read_robot(name, figures) for name, figures in FIGURES.items()}
"""Robots by name."""


def make_robot(name: str) -> Robot:
    """Return a robot by its name.

    Raises:
        ConfigError: no robot has this name; the message lists them.
    """
    require_known("robot", name, ROBOTS)
    return ROBOTS[name]
