"""Start poses: checks of a start, and the standing pose of a robot."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.robots.robot import Robot
from lirs_wct import ConfigError, FloatArray, Pose2, Pose3, SimulationError, WallGrid, World
from lirs_wct.errors import is_finite

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
    x, y = _disc(start, robot.radius)
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
    return Pose3.from_rpy(start.x, start.y, height, *_attitude_on(a, b, start.yaw), start.yaw)


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


def _attitude_on(a: float, b: float, yaw: float) -> tuple[float, float]:
    """Return roll and pitch, radians, on the plane z = a x + b y."""
    forward = a * math.cos(yaw) + b * math.sin(yaw)
    left = b * math.cos(yaw) - a * math.sin(yaw)
    pitch = -math.atan(forward)
    return math.atan(left * math.cos(pitch)), pitch


def _disc(center: Pose2, radius: float) -> tuple[FloatArray, FloatArray]:
    """Return x and y of points about 5 cm apart in a disc."""
    n = max(9, 2 * math.ceil(radius / 0.05) + 1)
    x, y = np.meshgrid(*2 * (np.linspace(-radius, radius, n),))
    within = np.hypot(x, y) <= radius
    return center.x + x[within], center.y + y[within]


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
