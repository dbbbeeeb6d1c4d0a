"""Courses to cross, from a kind of obstacle, a difficulty and a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from lirs_envs.generators.natural import NODES, fractal
from lirs_envs.generators.obstacles import OBSTACLES, X, Y, at_difficulty, nodes_within
from lirs_envs.generators.route import CELL, distance_to_route, maze, winding_route
from lirs_wct import HeightField, Pose2, World, unknown_name
from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.checks import positive, within
from lirs_wct.ground import Terrain

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
        difficulty: 0 to 1.
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
    if kind not in KINDS:
        raise unknown_name("kind of terrain", kind, KINDS)
    within("[0, 1]")(difficulty, "difficulty of a terrain")
    positive(scale, "scale of a terrain")
    positive(steepness, "steepness of a terrain")
    ground = _undulation(at_difficulty(difficulty, 0.05, 0.15, 0.3), rng)
    if kind == "mazes":
        rooms, open_share = at_difficulty(difficulty, 5, 7, 9), at_difficulty(difficulty, 0.6, 0.1, 0.0)
        walls, route = maze(round(rooms), open_share, rng)
        z = scale * (steepness * ground + max(1.0, MIN_WALL / scale) * walls)
    else:
        z, route = _crossing(kind, difficulty, rng)
        z = scale * steepness * np.clip(z + ground, *HEIGHT_RANGE)
    heights = z.astype(np.float32)
    start, goal = _ends(scale * route)
    return GeneratedTerrain(
        kind=kind,
        difficulty=float(difficulty),
        heights=heights,
        cell=scale * CELL,
        start=start,
        goal=goal,
        route=scale * route,
    )


def _crossing(kind: str, difficulty: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return (n, n) heights of obstacles with a gentle way through them, and the way."""
    route = winding_route(rng, sway=at_difficulty(difficulty, 2.0, 6.5, 8.0))
    obstacles, gentle = OBSTACLES[kind](difficulty, rng)
    half_width = at_difficulty(difficulty, 1.4, 1.1, 0.9)
    share = _smooth_step((distance_to_route(route) - half_width) / SHOULDER)
    z = gentle + share * (obstacles - gentle)
    for x, y in (route[0], route[-1]):
        _level(z, float(x), float(y))
    return z, route


def _undulation(relief: float, rng: np.random.Generator) -> FloatArray:
    """Return (n, n) heights of gently rolling ground around 0, meters."""
    coarse = relief * (fractal(rng, nodes=COARSE) - 0.5)
    return np.asarray(cv2.resize(coarse, (NODES, NODES), interpolation=cv2.INTER_CUBIC), dtype=np.float64)


def _level(z: FloatArray, x: float, y: float) -> None:
    """Level the ground around a point, in place."""
    reach = PAD + PAD_SHOULDER
    cols, rows = nodes_within(x, reach), nodes_within(-y, reach)
    distance = np.hypot(X[:, cols] - x, Y[rows] - y)
    part = z[rows, cols]
    level = part[distance <= PAD].mean()
    z[rows, cols] = level + _smooth_step((distance - PAD) / PAD_SHOULDER) * (part - level)


def _smooth_step(t: FloatArray | Float32Array) -> FloatArray:
    t = np.clip(np.asarray(t, dtype=np.float64), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _ends(route: FloatArray) -> tuple[Pose2, Pose2]:
    """Return the poses at both ends of a way, facing along it."""
    (x0, y0), (x1, y1) = route[0].tolist(), route[1].tolist()
    (x2, y2), (x3, y3) = route[-2].tolist(), route[-1].tolist()
    return Pose2(x0, y0, math.atan2(y1 - y0, x1 - x0)), Pose2(x3, y3, math.atan2(y3 - y2, x3 - x2))
