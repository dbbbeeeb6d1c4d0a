"""Terrain from a seed: natural ground, and courses to cross by obstacle and difficulty.

A course has one kind of obstacle from border to border. Each kind has a gentle version, used along the route
from west to east; a maze has a way through its rooms. Figures are for a Husky, whose limit lies between
difficulty 0 and 0.5: its wheels' radius is 0.165 m, and its friction of 0.7 holds it on 35 deg. Where the
gentle version is not level, its slopes stay below 12 deg.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from lirs_wct import HeightField, Pose2, World, require_known
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, njit
from lirs_wct.errors import positive, within
from lirs_wct.ground import Terrain

NODES = 257
"""Nodes along each side of a generated terrain."""
EDGE = 50.0
"""Side of a natural terrain, meters."""


def fractal(rng: np.random.Generator, hurst: float = 1.0, nodes: int = NODES) -> FloatArray:
    """Return (n, n) heights 0 to 1 of spectral synthesis (Saupe 1988). Amplitudes fall with k^-(H + 1)."""
    f = np.fft.fftfreq(nodes)
    k = np.hypot(f[:, None], f)
    k[0, 0] = np.inf
    z = np.fft.ifft2(k ** -(hurst + 1) * np.exp(2j * np.pi * rng.random(k.shape))).real
    heights: FloatArray = (z - z.min()) / np.ptp(z)
    return heights


def across(rng: np.random.Generator) -> FloatArray:
    """Return (n, n) signed distances from a random line through the center, -1.4 to 1.4."""
    u, angle = np.linspace(-1, 1, NODES), rng.uniform(0, np.pi)
    distance: FloatArray = u * np.cos(angle) + u[:, None] * np.sin(angle)
    return distance


def dunes(rng: np.random.Generator) -> FloatArray:
    """Return heights of dunes: long windward sides, short slip faces."""
    phase = (2.5 * across(rng) + 2 * fractal(rng, 1.2)) % 1
    ridge = cv2.GaussianBlur(np.where(phase < 0.7, phase / 0.7, (1 - phase) / 0.3), (0, 0), 4)
    return np.asarray(1.6 * ridge + fractal(rng, 1.2), dtype=np.float64)


def with_rocks(
    rng: np.random.Generator,
    z: FloatArray,
    count: int = 14,
    *,
    edge: float = EDGE,
    border: float = 3.0,
    radius: tuple[float, float] = (0.25, 0.8),
    height: tuple[float, float] = (0.4, 1.2),
) -> FloatArray:
    """Return heights with rocks on them, as domes with steep sides.

    Args:
        rng: Random generator of positions and sizes.
        z: (n, n) heights, meters.
        count: Number of rocks.
        edge: Side of the square, meters.
        border: Width along its sides where no rock has its middle; at least the largest radius, meters.
        radius: Least and largest radius, meters.
        height: Least and largest height, meters.
    """
    low, high = zip((border, edge - border), (border, edge - border), radius, height, strict=True)
    rocks = rng.uniform(low, high, (count, 4))
    z = np.array(z, dtype=np.float64)
    _add_rocks(z, np.linspace(0, edge, len(z)), rocks)
    return z


@njit
def _add_rocks(z: FloatArray, x: FloatArray, rocks: FloatArray) -> None:
    """Add rocks (n, 4), east, north, radius, height, to heights. The nodes are at `x` along both axes."""
    per_meter = (len(z) - 1) / x[-1]
    for east, north, wide, high in rocks:
        for i in range(int((north - wide) * per_meter), int((north + wide) * per_meter) + 2):
            for j in range(int((east - wide) * per_meter), int((east + wide) * per_meter) + 2):
                distance = math.hypot(x[j] - east, x[i] - north) / wide
                if distance < 1.0:
                    z[i, j] += high * math.sqrt(1.0 - distance**4)


NATURAL_TERRAINS: Mapping[str, Callable[[np.random.Generator], FloatArray]] = {
    "hills": lambda rng: 6 * fractal(rng),
    "rough hills": lambda rng: 5 * fractal(rng, 0.8),
    "valley": lambda rng: 7 * across(rng) ** 2 + 1.5 * fractal(rng),
    "dunes": dunes,
    "plain": lambda rng: 1.2 * fractal(rng),
    "hills with rocks": lambda rng: with_rocks(rng, 5 * fractal(rng)),
    "plain with rocks": lambda rng: with_rocks(rng, 1.2 * fractal(rng)),
}
"""Makers of (257, 257) heights in meters, 50 m square, by name."""

CELL = 0.1
"""Spacing of a course's nodes, meters."""
HALF = CELL * (NODES - 1) / 2
"""Half the side of a course, meters."""
ENDS = 10.8
"""Distance of start and goal west and east of the center, meters."""
LEG = 4.32
"""Distance along x between two bends of a route, meters."""
MAX_ROUTE_SLOPE = 1.4
"""Largest slope of a route between two bends, meters north or south per meter east."""
WALL_HEIGHT = 1.0
"""Meters; above the lidar of every ground robot."""
WALL_NODES = 3
"""Nodes across a wall."""
POINTS = 10
"""Points of the route from one room to the next."""
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""Row and column from a room to its neighbors."""
Room = tuple[int, int]
"""Row (0 = north) and column of a room."""


def winding_route(rng: np.random.Generator, sway: float) -> FloatArray:
    """Return (n, 2) x, y of a smooth way from west to east, at most `sway` off the middle line, meters."""
    x = np.linspace(-ENDS, ENDS, round(2 * ENDS / LEG) + 1)
    y = rng.uniform(-sway, sway, len(x))
    for k in range(1, len(x)):
        y[k] = y[k - 1] + np.clip(y[k] - y[k - 1], -MAX_ROUTE_SLOPE * LEG, MAX_ROUTE_SLOPE * LEG)
    fine = np.linspace(0, len(x) - 1, 20 * (len(x) - 1) + 1)
    leg = np.minimum(fine.astype(np.int64), len(x) - 2)
    blend = (1 - np.cos(np.pi * (fine - leg))) / 2
    return np.column_stack((np.interp(fine, np.arange(len(x)), x), y[leg] + blend * (y[leg + 1] - y[leg])))


def distance_to_route(route: FloatArray) -> Float32Array:
    """Return (n, n) distances in meters from nodes, row 0 = north, to a route of (n, 2) points."""
    pixels = np.round(np.column_stack((route[:, 0] + HALF, HALF - route[:, 1])) / CELL).astype(np.int32)
    off_route = np.ones((NODES, NODES), np.uint8)
    cv2.polylines(off_route, [pixels], isClosed=False, color=(0,))
    distance = cv2.distanceTransform(off_route, cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(distance * CELL, dtype=np.float32)


def maze(rooms: int, open_share: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return maze heights (n, n) in meters and the route (n, 2) through it, x, y.

    Args:
        rooms: Number of rooms along each side.
        open_share: Share of a perfect maze's walls that are left out.
        rng: Random generator of walls, start and goal.
    """
    start, goal = (int(rng.integers(rooms)), 0), (int(rng.integers(rooms)), rooms - 1)
    parent = _spanning_tree(rooms, start, rng)
    # Walls to the east and to the south of each room.
    east, south = np.ones((rooms, rooms), np.bool_), np.ones((rooms, rooms), np.bool_)
    for room, before in parent.items():
        row, col = min(room, before)
        (east if room[0] == before[0] else south)[row, col] = False
    east &= rng.random(east.shape) >= open_share
    south &= rng.random(south.shape) >= open_share
    chain = [goal]
    while chain[-1] != start:
        chain.append(parent[chain[-1]])
    pitch = 2 * HALF / rooms
    rows, cols = np.array(chain[::-1], dtype=np.float64).T
    fine = np.linspace(0, len(chain) - 1, POINTS * (len(chain) - 1) + 1)
    row, col = (np.interp(fine, np.arange(len(chain)), rooms_of) for rooms_of in (rows, cols))
    return _walls(east, south), np.column_stack(((col + 0.5) * pitch - HALF, HALF - (row + 0.5) * pitch))


def _spanning_tree(rooms: int, root: Room, rng: np.random.Generator) -> dict[Room, Room]:
    """Return each room's neighbor toward the root, from a depth-first search for long routes."""
    parent: dict[Room, Room] = {}
    visited, stack = {root}, [root]
    while stack:
        row, col = stack[-1]
        ahead = [
            (row + i, col + j)
            for i, j in STEPS
            if 0 <= row + i < rooms and 0 <= col + j < rooms and (row + i, col + j) not in visited
        ]
        if not ahead:
            stack.pop()
            continue
        room = ahead[int(rng.integers(len(ahead)))]
        parent[room] = row, col
        visited.add(room)
        stack.append(room)
    return parent


def _walls(east: BoolArray, south: BoolArray) -> FloatArray:
    """Return (n, n) heights of the walls between rooms and of those along the border."""
    rooms = len(east)
    edge = np.round(np.linspace(WALL_NODES // 2, NODES - 1 - WALL_NODES // 2, rooms + 1)).astype(np.int64)
    z = np.zeros((NODES, NODES))
    half = WALL_NODES // 2
    for side in (slice(0, WALL_NODES), slice(NODES - WALL_NODES, NODES)):
        z[side, :] = z[:, side] = WALL_HEIGHT
    for row, col in np.argwhere(east).tolist():
        z[edge[row] - half : edge[row + 1] + half + 1, edge[col + 1] - half : edge[col + 1] + half + 1] = (
            WALL_HEIGHT
        )
    for row, col in np.argwhere(south).tolist():
        z[edge[row + 1] - half : edge[row + 1] + half + 1, edge[col] - half : edge[col + 1] + half + 1] = (
            WALL_HEIGHT
        )
    return z


GENTLE = math.tan(math.radians(12))
"""Steepest slope of gentle ground, as a tangent."""
Obstacles = tuple[FloatArray, FloatArray]
"""(n, n) heights with obstacles, and gentle heights in the same place; meters, row 0 = north."""

X = np.linspace(-HALF, HALF, NODES)[None, :]
Y = np.linspace(HALF, -HALF, NODES)[:, None]


def at_difficulty(difficulty: float, easy: float, middle: float, hard: float) -> float:
    """Return a figure that is given at difficulties 0, 0.5 and 1."""
    return float(np.interp(difficulty, (0.0, 0.5, 1.0), (easy, middle, hard)))


def slopes(difficulty: float, rng: np.random.Generator) -> Obstacles:
    """Return ridges across the way with level crests and valleys."""
    slope = math.tan(math.radians(at_difficulty(difficulty, 8, 38, 48)))
    height = at_difficulty(difficulty, 0.8, 1.5, 2.2)
    at, z = [-2 * HALF], [0.0]
    while at[-1] < 2 * HALF:
        valley, run, crest = rng.uniform(1.5, 3), height / slope, rng.uniform(0.8, 1.6)
        at += (at[-1] + np.cumsum((valley, run, crest, run))).tolist()
        z += [0.0, height, height, 0.0]
    angle = rng.uniform(-0.3, 0.3)
    ridges = np.interp(X * math.cos(angle) + Y * math.sin(angle), at, z)
    return ridges, ridges * min(1.0, GENTLE / slope)


def steps(difficulty: float, rng: np.random.Generator) -> Obstacles:
    """Return terraces with upright risers, up and down at random."""
    riser = at_difficulty(difficulty, 0.04, 0.22, 0.34)
    treads = rng.uniform(1.2, 2.2, 30)
    # A walk in steps of one that turns round at -4 and 4.
    walk = np.cumsum(rng.choice((-1, 1), 30))
    level = np.abs((walk + 4) % 16 - 8) - 4
    at = np.cumsum(treads) - treads.sum() / 2
    bend = rng.uniform(0.3, 1.0) * np.sin(2 * math.pi * Y / rng.uniform(12, 25) + rng.uniform(0, 2 * math.pi))
    z: FloatArray = np.float64(riser) * level[np.clip(np.searchsorted(at, X + bend) - 1, 0, 29)]
    return z, np.array(cv2.GaussianBlur(z.astype(np.float32), (0, 0), 10), dtype=np.float64)


def stones(difficulty: float, rng: np.random.Generator) -> Obstacles:
    """Return a field of stones."""
    height = at_difficulty(difficulty, 0.05, 0.4, 0.7)
    level = np.zeros((NODES, NODES))
    count = round(at_difficulty(difficulty, 120, 320, 420))
    sizes = {"radius": (0.2, 0.5), "height": (0.6 * height, height)}
    return with_rocks(rng, level, count, edge=2 * HALF, border=0.6, **sizes), level


def waves(difficulty: float, rng: np.random.Generator) -> Obstacles:
    """Return waves from two directions."""
    amplitude = at_difficulty(difficulty, 0.08, 0.45, 0.6)
    length = at_difficulty(difficulty, 5.0, 2.6, 2.4)
    z = np.zeros((NODES, NODES))
    for share, heading in ((0.75, rng.uniform(-0.4, 0.4)), (0.35, rng.uniform(0.8, 1.4))):
        along = X * math.cos(heading) + Y * math.sin(heading)
        z += share * amplitude * np.sin(2 * math.pi * along / length + rng.uniform(0, 2 * math.pi))
    steepest = 2 * math.pi * amplitude / length
    return z, z * min(1.0, GENTLE / steepest)


def craters(difficulty: float, rng: np.random.Generator) -> Obstacles:
    """Return craters: round bowls, each with a low rim."""
    steepness = at_difficulty(difficulty, 0.1, 0.55, 0.8)
    largest = at_difficulty(difficulty, 1.8, 2.4, 2.8)
    count = round(at_difficulty(difficulty, 16, 60, 70))
    bowls = rng.uniform((-HALF, -HALF, 0.9), (HALF, HALF, largest), (count, 3))
    bowl, log_rim = np.zeros((NODES, NODES)), np.full((NODES, NODES), -np.inf)
    _dig(bowls, steepness, (X[0], Y[:, 0]), bowl, log_rim)
    z = bowl + np.exp(log_rim)
    return z, z * min(1.0, GENTLE / (2 * steepness))


@njit
def _dig(
    bowls: FloatArray,
    steepness: float,
    nodes: tuple[FloatArray, FloatArray],
    bowl: FloatArray,
    log_rim: FloatArray,
) -> None:
    """Dig bowls (n, 3), x, y, radius, with rims, at nodes of x and y; where two overlap, the larger counts.

    Rims are compared by logarithms: an exponential for each would take most of the time.
    """
    x, y = nodes
    south = -y
    for east, north, radius in bowls:
        reach, depth = 1.6 * radius, steepness * radius
        log_top = math.log(0.15 * depth)
        top, bottom = np.searchsorted(south, -north - reach), np.searchsorted(south, -north + reach)
        left, right = np.searchsorted(x, east - reach), np.searchsorted(x, east + reach)
        for i in range(top, bottom):
            for j in range(left, right):
                distance = math.sqrt((x[j] - east) ** 2 + (y[i] - north) ** 2) / radius
                bowl[i, j] = min(bowl[i, j], -depth * max(1 - distance**2, 0.0))
                log_rim[i, j] = max(log_rim[i, j], log_top - ((distance - 1) / 0.2) ** 2)


def nodes_within(middle: float, reach: float) -> slice:
    """Return the nodes along an axis whose coordinate is within reach of a middle."""
    first, last = np.searchsorted(X[0], (middle - reach, middle + reach))
    return slice(int(first), int(last))


def gaps(difficulty: float, rng: np.random.Generator) -> Obstacles:
    """Return winding trenches across the way."""
    width = at_difficulty(difficulty, 0.15, 0.8, 1.3)
    depth = at_difficulty(difficulty, 0.12, 0.7, 1.2)
    count = round(at_difficulty(difficulty, 4, 6, 7))
    middles = np.linspace(-ENDS, ENDS, count + 2)[1:-1] + rng.uniform(-0.4, 0.4, count)
    z = np.zeros((NODES, NODES))
    for middle in middles:
        length, phase = rng.uniform(8, 20), rng.uniform(0, 2 * math.pi)
        bend = rng.uniform(0.2, 0.7) * np.sin(2 * math.pi * Y / length + phase)
        z[np.abs(X - middle - bend) <= width / 2] = -depth
    return z, np.zeros((NODES, NODES))


OBSTACLES: Mapping[str, Callable[[float, np.random.Generator], Obstacles]] = {
    "slopes": slopes,
    "steps": steps,
    "stones": stones,
    "waves": waves,
    "craters": craters,
    "gaps": gaps,
}
"""Makers of obstacles by name; arguments are difficulty and random generator."""


KINDS = (*OBSTACLES, "mazes")
"""Kinds of courses."""
PAD = 0.9
"""Radius of the level ground around start and goal, meters."""
SHOULDER, PAD_SHOULDER = 0.8, 2.4
"""Width over which gentle and level ground go over into the rest, meters."""
COARSE = 64
"""Nodes along a side from which the rolling ground is interpolated."""
HEIGHT_RANGE = (-2.8, 3.4)
"""No course reaches below or above, meters at scale 1: room for every course in one model."""
MIN_WALL = 0.5
"""Least height of a maze's walls at any scale, meters: above the lidar of every ground robot."""


@dataclass(frozen=True, kw_only=True)
class GeneratedTerrain:
    """A square course with a gentle way through its obstacles.

    Attributes:
        kind: kind of its obstacles.
        heights: (257, 257) float32 meters, row 0 = north.
        cell: spacing of the nodes, meters; the middle is the world's origin.
        start: pose in the west, facing along the way.
        goal: pose in the east.
        route: (n, 2) x, y of the gentle way from start to goal, meters.
    """

    kind: str
    difficulty: float
    heights: Float32Array
    cell: float
    start: Pose2
    goal: Pose2
    route: FloatArray

    @property
    def surface(self) -> HeightField:
        """The heights as a surface."""
        return HeightField.centered(self.heights, (self.cell, self.cell))

    def world(self) -> World:
        """Return the course as a world whose one spawn pose is the start."""
        return World(self.kind, Terrain(self.surface), (self.start,), scale="generated")


def scaled_height_range(scale: float, steepness: float) -> tuple[float, float]:
    """Return the lowest and highest height of all courses of a scale and steepness, meters."""
    factor = scale * max(steepness, 1.0)
    return factor * HEIGHT_RANGE[0], max(factor * HEIGHT_RANGE[1], 2 * MIN_WALL)


def generate(
    kind: str, difficulty: float, rng: np.random.Generator, *, scale: float = 1.0, steepness: float = 1.0
) -> GeneratedTerrain:
    """Make a course; the same random generator gives the same one.

    Args:
        kind: kind of its obstacles (see `KINDS`).
        difficulty: 0 (straight ahead passes all but mazes) to 1; a Husky's own limit lies below 0.5, beyond
            that it needs the gentle way.
        rng: random generator of the whole course.
        scale: all lengths, relative to those for a Husky, whose course is 25.6 m square; the walls of a maze
            are never lower than 0.5 m.
        steepness: all slopes but those of walls, relative to those for a Husky.

    Raises:
        ConfigError: there is no such kind, the difficulty is not 0 to 1, or scale or steepness is not above
            0.
    """
    require_known("kind of terrain", kind, KINDS)
    within("[0, 1]")(difficulty, "difficulty of a terrain")
    positive(scale, "scale of a terrain")
    positive(steepness, "steepness of a terrain")
    # Gently rolling ground around 0.
    coarse = at_difficulty(difficulty, 0.05, 0.15, 0.3) * (fractal(rng, nodes=COARSE) - 0.5)
    ground = np.asarray(cv2.resize(coarse, (NODES, NODES), interpolation=cv2.INTER_CUBIC), dtype=np.float64)
    if kind == "mazes":
        rooms, open_share = at_difficulty(difficulty, 5, 7, 9), at_difficulty(difficulty, 0.6, 0.1, 0.0)
        walls, route = maze(round(rooms), open_share, rng)
        z = scale * (steepness * ground + max(1.0, MIN_WALL / scale) * walls)
    else:
        z, route = _crossing(kind, difficulty, rng)
        z = scale * steepness * np.clip(z + ground, *HEIGHT_RANGE)
    route = scale * route
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = route[[0, 1, -2, -1]].tolist()
    return GeneratedTerrain(
        kind=kind,
        difficulty=float(difficulty),
        heights=z.astype(np.float32),
        cell=scale * CELL,
        start=Pose2(x0, y0, math.atan2(y1 - y0, x1 - x0)),
        goal=Pose2(x3, y3, math.atan2(y3 - y2, x3 - x2)),
        route=route,
    )


def _crossing(kind: str, difficulty: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return (n, n) heights of obstacles with a gentle way through them, and the way."""
    route = winding_route(rng, sway=at_difficulty(difficulty, 2.0, 6.5, 8.0))
    obstacles, gentle = OBSTACLES[kind](difficulty, rng)
    half_width = at_difficulty(difficulty, 1.4, 1.1, 0.9)
    share = _smooth_step((distance_to_route(route) - half_width) / SHOULDER)
    z = gentle + share * (obstacles - gentle)
    reach = PAD + PAD_SHOULDER
    for x, y in (route[0].tolist(), route[-1].tolist()):
        cols, rows = nodes_within(x, reach), nodes_within(-y, reach)
        distance, part = np.hypot(X[:, cols] - x, Y[rows] - y), z[rows, cols]
        level = part[distance <= PAD].mean()
        z[rows, cols] = level + _smooth_step((distance - PAD) / PAD_SHOULDER) * (part - level)
    return z, route


def _smooth_step(t: FloatArray | Float32Array) -> FloatArray:
    t = np.clip(np.asarray(t, dtype=np.float64), 0.0, 1.0)
    return t * t * (3 - 2 * t)
