"""Square arena of 30 m from parameters: ground, obstacles, a corridor and walls around it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_envs.generators.terrain import fractal
from lirs_wct import BoolArray, FloatArray, HeightField, Pose2, World
from lirs_wct.errors import Checked, check_field, check_seed, limited
from lirs_wct.ground import Terrain

CELL = 0.1
"""Spacing of the nodes, meters."""
NODES = 301
SIDE = CELL * (NODES - 1)
"""Side of the arena, meters."""
WALL = 0.3
"""Thickness of walls, meters."""
WALL_HEIGHT = 2.0
"""Height of walls, meters."""
PIECES = 40
"""Pieces of the wall around the arena that can be left out."""
CLEAR = 2.5
"""Radius around the start without obstacles, meters."""
BORDER = 2.5
"""Distance of obstacles from the border, meters."""
SIZES = (0.4, 2.0)
"""Shortest and longest side of an obstacle, meters."""
REGULAR_SIZE = 1.0
"""Side of all obstacles of a symmetric arena, meters."""
ROUGHNESS_LENGTH = 3
"""Nodes over which roughness is smoothed."""


@dataclass(frozen=True, kw_only=True)
class ArenaConfig(Checked, of="an arena"):
    """Parameters of an arena; the defaults are level ground with boxes and a closed wall.

    Attributes:
        relief: height of smooth hills, meters.
        slope: inclination of the whole ground, degrees.
        slope_direction: direction in which the ground rises, degrees from the x axis, along the corridor.
        roughness: standard deviation of the small-scale heights, meters.
        obstacles: number of obstacles.
        obstacle_height: height of obstacles over the ground, meters.
        round_obstacles: share of obstacles that are round; the others are boxes.
        symmetry: regularity of the obstacles: 0 = at random, 1 = alike on a square grid.
        corridor: length of two parallel walls around the start, meters; 0 = none.
        corridor_width: distance between them, meters.
        boundary: share of the wall around the arena that stands.
        seed: Seed of the random positions and hills.
    """

    relief: float = limited(0.0, "[0, inf)")
    slope: float = limited(0.0, "[0, 45]", "deg")
    slope_direction: float = limited(90.0, "[-360, 360]", "deg")
    roughness: float = limited(0.0, "[0, inf)")
    obstacles: int = limited(20, "[0, inf)")
    obstacle_height: float = limited(2.0, "[0, inf)")
    round_obstacles: float = limited(0.0, "[0, 1]")
    symmetry: float = limited(0.0, "[0, 1]")
    corridor: float = limited(0.0, "[0, inf)")
    corridor_width: float = limited(3.0, "[0, inf)")
    boundary: float = limited(1.0, "[0, 1]")
    seed: int = check_field(check_seed, default=1)


def arena(name: str, config: ArenaConfig) -> World:
    """Return the arena; the robot starts in its middle, along the x axis.

    Every part has its own random stream: the hills do not move when an obstacle is added.
    """
    x = np.linspace(-SIDE / 2, SIDE / 2, NODES)[None, :]
    y = -x.T
    ground = _ground(config, x, y)
    top = np.zeros((NODES, NODES))
    _add_obstacles(top, config, x, y)
    if config.corridor > 0:
        inside = np.abs(x) <= config.corridor / 2
        top[inside & (np.abs(y) < config.corridor_width / 2 + WALL)] = 0.0
        walls = inside & (np.abs(np.abs(y) - config.corridor_width / 2 - WALL / 2) <= WALL / 2)
        top[walls] = WALL_HEIGHT
    # The outer wall without the pieces that are left out.
    standing: BoolArray = np.zeros(PIECES, np.bool_)
    order = np.random.default_rng((config.seed, 4)).permutation(PIECES)
    standing[order[: round(config.boundary * PIECES)]] = True
    piece = np.minimum(((np.arctan2(y, x) + math.pi) / math.tau * PIECES).astype(np.int64), PIECES - 1)
    top[(np.maximum(np.abs(x), np.abs(y)) > SIDE / 2 - WALL) & standing[piece]] = WALL_HEIGHT
    surface = HeightField.centered((ground + top).astype(np.float32), (CELL, CELL))
    start = Pose2(0.0, 0.0, 0.0)
    return World(name, Terrain(surface), (start,), scale="generated", start=start)


def _ground(config: ArenaConfig, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return (n, n) heights of the ground, meters."""
    direction, slope = math.radians(config.slope_direction), math.tan(math.radians(config.slope))
    z: FloatArray = slope * (x * math.cos(direction) + y * math.sin(direction))
    z = z + config.relief * (fractal(np.random.default_rng((config.seed, 1)), nodes=NODES) - 0.5)
    noise = np.random.default_rng((config.seed, 2)).standard_normal((NODES, NODES))
    smooth = np.cumsum(np.cumsum(np.pad(noise, ((ROUGHNESS_LENGTH, 0),) * 2), axis=0), axis=1)
    k = ROUGHNESS_LENGTH
    boxes = smooth[k:, k:] - smooth[:-k, k:] - smooth[k:, :-k] + smooth[:-k, :-k]
    rough: FloatArray = z + config.roughness * boxes / k
    return rough


def _add_obstacles(top: FloatArray, config: ArenaConfig, x: FloatArray, y: FloatArray) -> None:
    """Add obstacles to the heights (n, n) above the ground, in place."""
    count, s = int(config.obstacles), config.symmetry
    rng = np.random.default_rng((config.seed, 3))
    draws = rng.random((count, 6))
    reach = SIDE / 2 - BORDER
    per_side = max(2, math.ceil(math.sqrt(count)))
    grid = np.linspace(-reach, reach, per_side)
    for k, (u, v, a, b, turn, kind) in enumerate(draws):
        east = (1 - s) * reach * (2 * u - 1) + s * grid[k % per_side]
        north = (1 - s) * reach * (2 * v - 1) + s * grid[k // per_side]
        sizes = (1 - s) * (SIZES[0] + (SIZES[1] - SIZES[0]) * np.array((a, b))) + s * REGULAR_SIZE
        half = float(np.hypot(*sizes)) / 2
        if math.hypot(east, north) - half < CLEAR:
            continue
        angle = (1 - s) * math.pi * turn
        along = (x - east) * math.cos(angle) + (y - north) * math.sin(angle)
        across = (y - north) * math.cos(angle) - (x - east) * math.sin(angle)
        if kind < config.round_obstacles:
            inside = np.hypot(along, across) <= sizes[0] / 2
        else:
            inside = (np.abs(along) <= sizes[0] / 2) & (np.abs(across) <= sizes[1] / 2)
        top[inside] = config.obstacle_height
