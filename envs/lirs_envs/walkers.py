"""Walkers: upright capsules of a person's size that walk to and fro on straight legs.

Each walker has its own constant speed and a path of random way points on free ground. It does not walk into
the robot: it waits where the next step would bring it closer than `GAP` and turns back after `PATIENCE`.
A robot can drive into a walker, which is as hard as a wall.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from copy import copy

import mujoco
import numpy as np

from lirs_wct import OccupancyGrid, Pose2, SimulationError, World
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray, njit
from lirs_wct.navigation import largest_area

CLEARANCE = 0.45
"""Distance of a walker's center from walls, steep ground and the border, meters."""
MAX_SLOPE = math.radians(25)
"""Steepest ground that walkers walk on."""
RESOLUTION = 0.2
"""Cells of the free ground, meters."""
WAY_POINTS = 6
"""Way points of a path."""
LEG = (3.0, 10.0)
"""Shortest and longest leg, meters; a path ends where no tried direction is free."""
TRIES = 24
"""Legs tried from a way point."""

Disc = tuple[float, float, float]
"""x, y, radius; meters."""


def walkable_ground(world: World) -> OccupancyGrid:
    """Return the ground for walkers: the largest connected free area of a world."""
    free = world.traversable(clearance=CLEARANCE, max_slope=MAX_SLOPE, resolution=RESOLUTION)
    area = largest_area(free.free)
    if not area.any():
        raise SimulationError(f"{world.name}: no ground is free for walkers")
    return OccupancyGrid.from_mask(~area, free.resolution, free.origin)


def draw_paths(
    ground: OccupancyGrid, count: int, rng: np.random.Generator, keep_out: Iterable[Disc] = ()
) -> FloatArray:
    """Return (count, WAY_POINTS, 2) way points, x and y, joined by free legs that enter none of some discs.

    A path that ends early has its last way point again.
    """
    free = ground.free.copy()
    x, y = ground.centers(np.argwhere(free)).T
    inside = np.zeros(len(x), np.bool_)
    for disc_x, disc_y, radius in keep_out:
        inside |= np.hypot(x - disc_x, y - disc_y) < radius
    free[free] = ~inside
    cells = np.argwhere(free)
    if len(cells) == 0:
        raise SimulationError("no ground is free for walkers besides the robot and the props")
    paths = np.empty((count, WAY_POINTS, 2))
    first = cells[rng.integers(len(cells), size=count)]
    _extend_paths(free, ground.resolution, first, rng.random((count, WAY_POINTS - 1, TRIES, 2)), paths)
    corner = np.array((ground.origin.x, ground.origin.y))
    moved: FloatArray = paths + corner
    return moved


@njit
def _extend_paths(
    free: BoolArray, resolution: float, first: IntArray, uniform: FloatArray, paths: FloatArray
) -> None:
    """Fill paths (n, m, 2), meters from the grid's corner, from first cells (n, 2)."""
    for k in range(len(paths)):
        paths[k, 0, 0] = (first[k, 1] + 0.5) * resolution
        paths[k, 0, 1] = (first[k, 0] + 0.5) * resolution
        for leg in range(paths.shape[1] - 1):
            x, y = paths[k, leg]
            paths[k, leg + 1] = paths[k, leg]
            for t in range(uniform.shape[2]):
                angle = 2 * math.pi * uniform[k, leg, t, 0]
                length = LEG[0] + (LEG[1] - LEG[0]) * uniform[k, leg, t, 1]
                to_x, to_y = x + length * math.cos(angle), y + length * math.sin(angle)
                if _leg_is_free(free, resolution, x, y, to_x, to_y):
                    paths[k, leg + 1, 0], paths[k, leg + 1, 1] = to_x, to_y
                    break


@njit
def _leg_is_free(free: BoolArray, resolution: float, x: float, y: float, to_x: float, to_y: float) -> bool:
    """Whether points at most a quarter of a cell apart all lie in free cells."""
    steps = math.ceil(4 * math.hypot(to_x - x, to_y - y) / resolution)
    for i in range(steps + 1):
        col = math.floor((x + (to_x - x) * i / steps) / resolution)
        row = math.floor((y + (to_y - y) * i / steps) / resolution)
        if row < 0 or col < 0 or row >= free.shape[0] or col >= free.shape[1] or not free[row, col]:
            return False
    return True


RADIUS, HEIGHT = 0.25, 1.75
"""Of a walker, meters."""
HALF_LENGTH = HEIGHT / 2 - RADIUS
"""Half the straight part of its capsule, meters."""
SPEED = (0.5, 1.5)
"""Slowest and fastest, m/s."""
GAP = 0.3
"""Distance between walker and robot at which a walker waits, meters."""
PATIENCE = 1.0
"""Seconds after which a waiting walker turns back."""
START_GAP = 1.0
"""Distance of paths from the robot's start, meters."""
TOUCHABLE = 8
"""Number of nearest walkers with a body in MuJoCo: a body for each of 50 would cost 0.4 % of every step."""
WALKER_STREAM = 14
"""Random stream of the paths."""
WALKER_GROUP, PROP_GROUP = 0, 1
"""Geom groups of walkers and props, which the lidar may see through MuJoCo's rays; no robot uses them."""
WALKER_BIT = 2
"""Bit of MuJoCo's contact filter: walkers touch geoms with this affinity, so neither ground nor walls."""


class Walkers:
    """The walkers of a world.

    Attributes:
        centers: (n, 3) their middles now, meters.
        touchable: (m, 3) middles of those that are nearest to the robot.

    Args:
        world: world with the free ground of the walkers.
        robot_radius: radius of the robot that walkers avoid, meters.
        props: x, y and radius of the props.
        bodies: number of walkers that MuJoCo has a body of, m.
    """

    def __init__(
        self,
        world: World,
        count: int,
        robot_radius: float,
        props: Sequence[Disc] = (),
        *,
        bodies: int = TOUCHABLE,
    ) -> None:
        self._ground = walkable_ground(world)
        self._z, self._frame = world.surface.z, (*world.surface.origin, *world.surface.cell)
        self._robot_radius = robot_radius
        self._props = [(x, y, radius + RADIUS) for x, y, radius in props]
        self.centers = np.zeros((count, 3))
        self.touchable = np.zeros((min(bodies, count), 3))
        self._paths, self._ends = np.zeros((count, WAY_POINTS, 2)), np.zeros((count, WAY_POINTS))
        self._speeds, self._along, self._waited = np.zeros((3, count))
        self._direction = np.ones(count, np.int64)

    def reset(self, start: Pose2, rng: np.random.Generator) -> None:
        """Draw paths, speeds and initial positions of the walkers.

        The paths keep away from the robot's start.
        """
        count = len(self.centers)
        keep_out = (*self._props, (start.x, start.y, self._robot_radius + RADIUS + START_GAP))
        self._paths = draw_paths(self._ground, count, rng, keep_out)
        legs = np.hypot(*np.moveaxis(np.diff(self._paths, axis=1), 2, 0))
        self._ends = np.concatenate((np.zeros((count, 1)), np.cumsum(legs, axis=1)), axis=1)
        self._speeds = rng.uniform(*SPEED, count)
        self._along = rng.random(count) * self._ends[:, -1]
        self._direction = rng.choice((-1, 1), count)
        self._waited = np.zeros(count)
        self.advance(0.0, start.x, start.y)

    def advance(self, dt: float, robot_x: float, robot_y: float) -> None:
        """Walk for `dt` seconds; the robot stands at x, y."""
        _walk(
            (self._paths, self._ends, self._speeds),
            (self._along, self._direction, self._waited),
            dt,
            (robot_x, robot_y, self._robot_radius + RADIUS + GAP),
            self._z,
            self._frame,
            self.centers,
            self.touchable,
        )

    def copy(self) -> Walkers:
        """Return walkers that walk on from here alone."""
        copied = copy(self)
        for name in ("_along", "_direction", "_waited", "centers", "touchable"):
            setattr(copied, name, getattr(self, name).copy())
        return copied


def add_walkers(spec: mujoco.MjSpec, count: int) -> None:
    """Add walkers to a robot's specification as mocap bodies, which its geoms touch."""
    for geom in spec.geoms:
        if geom.contype:
            geom.conaffinity |= WALKER_BIT
    for k in range(count):
        body = spec.worldbody.add_body(name=f"walker{k}", mocap=True)
        body.add_geom(
            name=f"walker{k}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=(RADIUS, HALF_LENGTH, 0.0),
            contype=WALKER_BIT,
            conaffinity=0,
            priority=0,
            group=WALKER_GROUP,
            rgba=(0.2, 0.35, 0.6, 1.0),
        )


@njit
def _walk(
    paths: tuple[FloatArray, FloatArray, FloatArray],
    state: tuple[FloatArray, IntArray, FloatArray],
    dt: float,
    robot: Disc,
    z: Float32Array,
    frame: tuple[float, float, float, float],
    centers: FloatArray,
    touchable: FloatArray,
) -> None:
    """Move walkers for `dt` seconds, and fill `centers` (n, 3) and `touchable` (m, 3), the nearest first.

    Args:
        paths: Way points (n, m, 2), distances to them along the path (n, m), speeds (n,).
        state: Distance along the path (n,), direction 1 or -1 (n,), seconds waited (n,); changed.
        dt: Seconds.
        robot: x, y, and the distance of the middles at which a walker waits.
        z: Heights of the surface, row 0 = north.
        frame: x, y of its south-west node, cell x, y.
        centers: Middles; those of the last call where dt is above 0.
        touchable: Middles of those nearest to the robot.
    """
    points, ends, speeds = paths
    along, direction, waited = state
    for k in range(len(speeds)):
        last = ends[k, -1]
        to, way = along[k] + direction[k] * speeds[k] * dt, direction[k]
        if to < 0.0:
            to, way = -to, 1
        elif to > last:
            to, way = 2 * last - to, -1
        to = min(max(to, 0.0), last)
        x, y = _point_on_path(points[k], ends[k], to)
        gap = math.hypot(x - robot[0], y - robot[1])
        if gap < robot[2] and gap < math.hypot(centers[k, 0] - robot[0], centers[k, 1] - robot[1]):
            waited[k] += dt
            if waited[k] >= PATIENCE:
                direction[k], waited[k] = -direction[k], 0.0
            continue
        along[k], direction[k], waited[k] = to, way, 0.0
        centers[k, 0], centers[k, 1] = x, y
        centers[k, 2] = _height(z, frame, x, y) + HEIGHT / 2
    squared = (centers[:, 0] - robot[0]) ** 2 + (centers[:, 1] - robot[1]) ** 2
    for k in range(len(touchable)):
        nearest = np.argmin(squared)
        touchable[k] = centers[nearest]
        squared[nearest] = np.inf


@njit
def _point_on_path(points: FloatArray, ends: FloatArray, along: float) -> tuple[float, float]:
    """Return x, y at a distance along a path."""
    leg = 0
    while leg < len(ends) - 2 and ends[leg + 1] < along:
        leg += 1
    length = ends[leg + 1] - ends[leg]
    t = (along - ends[leg]) / length if length > 0.0 else 0.0
    x = points[leg, 0] + t * (points[leg + 1, 0] - points[leg, 0])
    y = points[leg, 1] + t * (points[leg + 1, 1] - points[leg, 1])
    return x, y


@njit
def _height(z: Float32Array, frame: tuple[float, float, float, float], x: float, y: float) -> float:
    """Return the height of a surface at a point on it (see `HeightField.height_at`)."""
    rows, cols = z.shape
    u, v = (x - frame[0]) / frame[2], (y - frame[1]) / frame[3]
    i, j = min(max(int(u), 0), cols - 2), min(max(int(v), 0), rows - 2)
    u, v, south = u - i, v - j, rows - 1 - j
    sw, ne = z[south, i], z[south - 1, i + 1]
    if u >= v:
        se = z[south, i + 1]
        return float(sw + u * (se - sw) + v * (ne - se))
    nw = z[south - 1, i]
    return float(sw + u * (ne - nw) + v * (nw - sw))
