"""The robots as data: one MJCF file under `assets/` and one row here each.

What a robot's MJCF file must hold: its options (timestep, solver); a body `base_link` with a free joint and
`sleep="never"`; a velocity actuator for each driven wheel with the name of its joint; the sensor
`accelerometer` on the base; contact geoms with `priority="1"`, so that the robot's one friction holds on
every ground; a camera `chase`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.pose import Pose3

ASSETS = Path(__file__).parent / "assets"


@dataclass(frozen=True, kw_only=True)
class Robot:
    """What is said about a robot outside its MJCF file.

    Attributes:
        name: how users call it; its MJCF file is `assets/NAME.xml`.
        left_wheels: joints (and actuators) of the driven wheels on the left.
        right_wheels: the same on the right.
        wheel_radius: loaded, metres.
        wheelbase: between front and rear driven axle, metres; 0 = one driven axle (differential drive).
        track: between left and right wheels, metres.
        base_height: base_link above level ground, metres.
        radius: of the circle around base_link that holds the robot, metres.
        max_speed: metres a second.
        max_turn_rate: rad/s.
        max_acceleration: m/s^2.
        max_turn_acceleration: rad/s^2.
        max_slope: steepest ground that it is set down on or sent over, radians.
        friction: sliding friction of all its contact geoms.
        lidar: name of its LRF preset.
        T_base_laser: mount of the LRF, such that the body is never in the way.

    Raises:
        ConfigError: a figure is not legal.
    """

    name: str
    left_wheels: tuple[str, ...]
    right_wheels: tuple[str, ...]
    wheel_radius: float
    wheelbase: float
    track: float
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
        if not self.left_wheels or not self.right_wheels:
            raise ConfigError(f"robot {self.name!r} needs driven wheels on both sides")
        for name in (
            "wheel_radius",
            "track",
            "base_height",
            "radius",
            "max_speed",
            "max_turn_rate",
            "max_acceleration",
            "max_turn_acceleration",
            "max_slope",
            "friction",
        ):
            if not 0 < getattr(self, name) < math.inf:
                raise ConfigError(
                    f"robot {self.name!r}: {name} must be a finite number above 0, got {getattr(self, name)}"
                )
        if not 0 <= self.wheelbase < math.inf:
            raise ConfigError(f"robot {self.name!r}: wheelbase must be at least 0 m, got {self.wheelbase}")

    @property
    def mjcf(self) -> Path:
        """The robot's MJCF file."""
        return ASSETS / f"{self.name}.xml"

    @property
    def skid_factor(self) -> float:
        """Wheel speed difference over `track` times yaw rate while all wheels slide or roll.

        On the spot a wheel slides sideways at wheelbase / 2 times the yaw rate. Dry friction opposes the
        slip's direction, and the moments of its two parts cancel where slip ahead / slip sideways =
        wheelbase / track; hence 1 + (wheelbase / track)^2, whatever the friction (1.80 for a Husky, whose
        makers drive it with 1.875). 1 for a single driven axle.
        """
        return 1 + (self.wheelbase / self.track) ** 2


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
    )
}
"""Robots by name."""


def make_robot(name: str) -> Robot:
    """Return a robot by its name.

    Raises:
        ConfigError: no robot has this name; the message lists them.
    """
    if name not in ROBOTS:
        raise unknown_name("robot", name, ROBOTS)
    return ROBOTS[name]
