"""Props: boxes, cylinders, spheres and static robots in a world."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco

from lirs_envs.robots.robot import Robot
from lirs_wct import ConfigError, Pose2, Pose3, World
from lirs_wct.errors import Checked, check_field, is_finite, limited, one_of

PROP_GROUP = 1
"""Geom group of props, which the lidar sees through MuJoCo's rays; no robot uses it."""
STATIC_ROBOT = "static_robot"
"""Prefix of the names of a static robot's bodies and geoms."""
SHAPES = {
    "box": (mujoco.mjtGeom.mjGEOM_BOX, 3),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, 2),
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, 1),
}
DROP = 0.005
"""Meters above the ground at which props are let go."""


@dataclass(frozen=True, kw_only=True)
class Prop(Checked, of="a prop"):
    """A body that stands on the ground.

    Attributes:
        shape: `box`, `cylinder` (upright) or `sphere`.
        size: half extents of a box, radius and half height of a cylinder, radius of a sphere; meters.
        place: pose on the ground.
        mass: kg; 0 = fixed.

    Raises:
        ConfigError: a value is not legal.
    """

    shape: Literal["box", "cylinder", "sphere"] = check_field(one_of(SHAPES))
    size: tuple[float, ...]
    place: Pose2
    mass: float = limited(0.0, "[0, inf)", "kg")

    def __post_init__(self) -> None:
        super().__post_init__()
        count = SHAPES[self.shape][1]
        if len(self.size) != count or not all(0 < s < math.inf for s in self.size):
            raise ConfigError(f"a {self.shape} needs {count} finite sizes above 0 m, got {self.size}")
        _check(self.place)

    @property
    def height(self) -> float:
        """From the ground to the middle, meters."""
        return self.size[-1]


@dataclass(frozen=True)
class StaticRobot:
    """Another robot, standing with its wheels held."""

    robot: Robot
    place: Pose2

    def __post_init__(self) -> None:
        _check(self.place)


def footprint(prop: Prop | StaticRobot) -> tuple[float, float, float]:
    """Return x, y and radius of a disc that holds a prop, meters."""
    if isinstance(prop, StaticRobot):
        return prop.place.x, prop.place.y, prop.robot.radius
    radius = math.hypot(*prop.size[:2]) if prop.shape == "box" else prop.size[0]
    return prop.place.x, prop.place.y, radius


def add_props(spec: mujoco.MjSpec, world: World, props: Sequence[Prop | StaticRobot]) -> None:
    """Add props to a specification, on the world's ground."""
    for k, prop in enumerate(props):
        height = prop.height if isinstance(prop, Prop) else prop.robot.base_height
        T = _standing(world, prop.place, height)
        if isinstance(prop, StaticRobot):
            _add_robot(spec, prop.robot, T, f"{STATIC_ROBOT}{k}_")
            continue
        body = spec.worldbody.add_body(name=f"prop{k}", pos=T.position, quat=T.quaternion)
        if prop.mass:
            body.add_freejoint(name=f"prop{k}")
            # A pickle of MuJoCo's data loses the sleep state of bodies and could not be stepped.
            body.sleep = mujoco.mjtSleepPolicy.mjSLEEP_NEVER
        size = (*prop.size, 0.0, 0.0)[:3]
        body.add_geom(
            name=f"prop{k}",
            type=SHAPES[prop.shape][0],
            size=size,
            mass=prop.mass or 1.0,
            group=PROP_GROUP,
            rgba=(0.7, 0.3, 0.2, 1),
        )


def _add_robot(spec: mujoco.MjSpec, robot: Robot, T: Pose3, prefix: str) -> None:
    other = mujoco.MjSpec.from_file(str(robot.mjcf))
    other.option.timestep = spec.option.timestep
    for geom in other.geoms:
        if geom.contype == 0:
            geom.group = PROP_GROUP
    base = other.body("base_link")
    base.pos = (0.0, 0.0, 0.0)
    frame = spec.worldbody.add_frame(pos=T.position, quat=T.quaternion)
    frame.attach_body(base, prefix, "")


def _standing(world: World, place: Pose2, height: float) -> Pose3:
    ground = float(world.surface.height_at(place.x, place.y))
    if not math.isfinite(ground):
        raise ConfigError(f"a prop must stand within the world, got ({place.x:.2f}, {place.y:.2f})")
    return Pose3.from_pose2(place, ground + height + DROP)


def _check(place: Pose2) -> None:
    if not all(is_finite(v) for v in (place.x, place.y, place.yaw)):
        raise ConfigError(f"a prop's place must be finite, got {place}")
