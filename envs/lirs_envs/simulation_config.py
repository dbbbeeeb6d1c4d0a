"""Configuration of a simulation: robot, sensors, props and walkers, and the places of robot and props."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from lirs_envs.lidar.presets import LidarPreset, make_lidar_preset
from lirs_envs.lidar.ray_casting import RAYS, Rays
from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.imu import InertialNoise
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.walkers import PROP_GROUP, TOUCHABLE
from lirs_wct import ConfigError, Pose2, Pose3, SimulationError, WallGrid, World
from lirs_wct.contact import CONTACT_GEOMETRIES, ContactGeometry
from lirs_wct.errors import Checked, check_field, is_finite, limited, of_type, one_of

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


@dataclass(frozen=True, kw_only=True)
class SimulationConfig(Checked):
    """Configuration of a simulation: robot, sensors, props and walkers.

    Attributes:
        lidar: name of a lidar preset; None = the robot's own.
        noise: errors of all sensors.
        rays: Caster of the rays: `builtin`, or `mujoco` for comparison, whose rays meet its
            hfield, or with contact geometry `mesh` those of its mesh.
        contact_geometry: contact ground in MuJoCo: `hfield`, `mesh` (the same, and its rays meet the mesh),
            `prisms` or `convex`.
        props: bodies and static robots that stand in the world; touched, and seen by the lidar.
        actors: number of walkers on seeded paths (see `lirs_envs.walkers`); touched, and seen by the
            lidar.
        start: pose where a reset sets the robot down; None = the world's first start pose.
        height_range: lowest and highest height that `replace_terrain` may write, meters; wheels
            then touch the surface itself, node by node. None = the ground stays.
        inertial: noise of inertial readings near 200 Hz, which observations then hold; None = none.

    Raises:
        ConfigError: a value is of the wrong type or not legal.
    """

    robot: Robot = check_field(of_type(Robot))
    lidar: str | None = None
    noise: SensorNoise = check_field(of_type(SensorNoise), default_factory=SensorNoise)
    rays: Rays = check_field(one_of(RAYS), default="builtin")
    contact_geometry: ContactGeometry = check_field(one_of(CONTACT_GEOMETRIES), default="hfield")
    props: Sequence[Prop | StaticRobot] = ()
    actors: int = limited(0, "[0, inf)", whole=True)
    start: Pose2 | None = None
    height_range: tuple[float, float] | None = None
    inertial: InertialNoise | None = check_field(of_type(InertialNoise), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "props", tuple(self.props))
        for prop in self.props:
            if not isinstance(prop, Prop | StaticRobot):
                raise ConfigError(f"props must be Prop or StaticRobot, got {prop!r}")
        if self.start is not None:
            check_start(self.start)
        make_lidar_preset(self.preset_name)
        z = self.height_range
        if z is not None and not (len(z) == 2 and all(map(is_finite, z)) and z[0] < z[1]):
            raise ConfigError(f"height_range must be lowest, highest, finite meters, got {z!r}")
        if z is not None and self.contact_geometry != "hfield":
            raise ConfigError(
                f"a terrain can be replaced with contact geometry hfield alone, got {self.contact_geometry}"
            )

    @property
    def walker_bodies(self) -> int:
        """Number of walkers with a MuJoCo body; with MuJoCo's rays, all of them."""
        return self.actors if self.rays == "mujoco" else min(self.actors, TOUCHABLE)

    @property
    def preset_name(self) -> str:
        """Name of the lidar preset."""
        return self.robot.lidar if self.lidar is None else self.lidar

    @property
    def preset(self) -> LidarPreset:
        """Specification of the lidar."""
        return make_lidar_preset(self.preset_name)


SLACK = math.radians(2)
"""Margin of a start's slope above the robot's `max_slope`: plans measure slopes over a shorter distance."""
CLEARANCE = 0.01
"""Height of a released robot above the highest ground under it, meters."""
MAX_SETTLING_DISTANCE = 0.1
"""Largest motion of a robot while it settles at a valid start, meters."""


def resolve_start(world: World, start: Pose2 | None) -> Pose2:
    """Return the start pose: the one given, or the world's first."""
    if start is None:
        if not world.spawn_poses:
            raise SimulationError(f"world {world.name!r} has no free place to start from; give a start pose")
        return world.spawn_poses[0]
    check_start(start)
    return start


def check_start(start: object) -> None:
    """Check a start pose."""
    if not isinstance(start, Pose2):
        raise ConfigError(f"a start must be a Pose2 or None, got {start!r}")
    if not all(is_finite(v) for v in (start.x, start.y, start.yaw)):
        raise ConfigError(f"a start pose must be finite, got {start}")


def check_fit(world: object, robot: object) -> None:
    """Check that a robot fits into a world."""
    if not isinstance(world, World):
        raise ConfigError(f"world must be of type World, got {world!r}")
    if not isinstance(robot, Robot):
        raise ConfigError(f"robot must be of type Robot, got {robot!r}")
    if min(world.surface.size) < 2 * robot.radius:
        width, depth = world.surface.size
        raise ConfigError(
            f"{robot.name} is {2 * robot.radius:g} m wide: "
            f"too large for {world.name!r} of {width:g} x {depth:g} m"
        )


def standing_pose(world: World, robot: Robot, start: Pose2) -> Pose3:
    """Return the pose just above the ground from which a robot is released at `start`."""
    where = f"{robot.name} cannot start at ({start.x:.2f}, {start.y:.2f})"
    west, south, east, north = world.surface.bounds
    inside = west <= start.x - robot.radius and start.x + robot.radius <= east
    if not (inside and south <= start.y - robot.radius and start.y + robot.radius <= north):
        raise SimulationError(
            f"{where}: it needs {robot.radius:g} m to the border of the world, which reaches from "
            f"({west:g}, {south:g}) to ({east:g}, {north:g})"
        )
    if world.walls is not None and _touches_wall(world.walls, start, robot.radius):
        raise SimulationError(f"{where}: a wall or a hole is within {robot.radius:g} m")
    # Points about 5 cm apart in a disc.
    n = max(9, 2 * math.ceil(robot.radius / 0.05) + 1)
    x, y = np.meshgrid(*2 * (np.linspace(-robot.radius, robot.radius, n),))
    within = np.hypot(x, y) <= robot.radius
    x, y = start.x + x[within], start.y + y[within]
    z = world.surface.height_at(x, y)
    if robot.flies:
        return Pose3.from_pose2(start, float(np.max(z)) + robot.base_height)
    plane, *_ = np.linalg.lstsq(np.stack((x - start.x, y - start.y, np.ones_like(x)), axis=1), z)
    a, b, height = plane.tolist()
    rough = float(np.max(z - (a * (x - start.x) + b * (y - start.y) + height)))
    if rough > robot.base_height:
        raise SimulationError(f"{where}: an obstacle stands {rough:.2f} m out of the ground there")
    slope = math.atan(math.hypot(a, b))
    if slope > robot.max_slope + SLACK:
        raise SimulationError(
            f"{where}: the ground slopes by {math.degrees(slope):.0f} deg, "
            f"legal: up to {math.degrees(robot.max_slope):.0f}"
        )
    height += robot.base_height / math.cos(slope) + max(rough, 0.0) + CLEARANCE
    cos, sin = math.cos(start.yaw), math.sin(start.yaw)
    pitch = -math.atan(a * cos + b * sin)
    roll = math.atan((b * cos - a * sin) * math.cos(pitch))
    return Pose3.from_rpy(start.x, start.y, height, roll, pitch, start.yaw)


def can_stand(world: World, robot: Robot, start: Pose2) -> bool:
    """Whether a robot can be set down; the free cells know nothing of rough ground under its whole body."""
    try:
        standing_pose(world, robot, start)
    except SimulationError:
        return False
    return True


def check_settled(robot: Robot, start: Pose2, settled: Pose3, *, tipped: bool) -> None:
    """Check that a robot came to rest where it was released."""
    if math.hypot(settled.x - start.x, settled.y - start.y) > MAX_SETTLING_DISTANCE or tipped:
        raise SimulationError(
            f"{robot.name} does not stay at ({start.x:.2f}, {start.y:.2f}): "
            f"it slid or tipped to ({settled.x:.2f}, {settled.y:.2f})"
        )


def _touches_wall(walls: WallGrid, start: Pose2, radius: float) -> bool:
    """Whether a cell without floor to stand on has a point within `radius`."""
    x, y = walls.origin.inverse().apply((start.x, start.y)).tolist()
    rows, cols = walls.shape
    reach = np.array((-radius, radius)) / walls.resolution
    r0, r1 = np.clip(np.floor(y / walls.resolution + reach), 0, rows - 1).astype(int).tolist()
    c0, c1 = np.clip(np.floor(x / walls.resolution + reach), 0, cols - 1).astype(int).tolist()
    solid = np.argwhere(~walls.floor[r0 : r1 + 1, c0 : c1 + 1]) + np.array((r0, c0))
    low = solid * walls.resolution
    nearest = np.clip((y, x), low, low + walls.resolution)
    return bool((np.hypot(*(nearest - (y, x)).T) <= radius).any())


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
        ground = float(world.surface.height_at(prop.place.x, prop.place.y))
        if not math.isfinite(ground):
            place = f"({prop.place.x:.2f}, {prop.place.y:.2f})"
            raise ConfigError(f"a prop must stand within the world, got {place}")
        T = Pose3.from_pose2(prop.place, ground + height + DROP)
        if isinstance(prop, StaticRobot):
            other = mujoco.MjSpec.from_file(str(prop.robot.mjcf))
            other.option.timestep = spec.option.timestep
            for geom in other.geoms:
                if geom.contype == 0:
                    geom.group = PROP_GROUP
            base = other.body("base_link")
            base.pos = (0.0, 0.0, 0.0)
            frame = spec.worldbody.add_frame(pos=T.position, quat=T.quaternion)
            frame.attach_body(base, f"{STATIC_ROBOT}{k}_", "")
            continue
        body = spec.worldbody.add_body(name=f"prop{k}", pos=T.position, quat=T.quaternion)
        if prop.mass:
            body.add_freejoint(name=f"prop{k}")
            # A pickle of MuJoCo's data loses the sleep state of bodies and could not be stepped.
            body.sleep = mujoco.mjtSleepPolicy.mjSLEEP_NEVER
        body.add_geom(
            name=f"prop{k}",
            type=SHAPES[prop.shape][0],
            size=(*prop.size, 0.0, 0.0)[:3],
            mass=prop.mass or 1.0,
            group=PROP_GROUP,
            rgba=(0.7, 0.3, 0.2, 1),
        )


def _check(place: Pose2) -> None:
    if not all(is_finite(v) for v in (place.x, place.y, place.yaw)):
        raise ConfigError(f"a prop's place must be finite, got {place}")
