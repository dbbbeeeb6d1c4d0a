"""Ground with one kind of obstacle from border to border.

Each kind has a gentle version, used along the route.

Figures are for a Husky, whose limit lies between difficulty 0 and 0.5: its wheels' radius is 0.165 m, and its
friction of 0.7 holds it on 35 deg. Where the gentle version is not level, its slopes stay below 12 deg.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import cv2
import numpy as np

from lirs_envs.generators.natural import NODES, with_rocks
from lirs_envs.generators.route import ENDS, HALF
from lirs_wct.arrays import FloatArray, IntArray, njit

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
    level = _fold(np.cumsum(rng.choice((-1, 1), 30)), 4)
    at = np.cumsum(treads) - treads.sum() / 2
    bend = rng.uniform(0.3, 1.0) * np.sin(2 * math.pi * Y / rng.uniform(12, 25) + rng.uniform(0, 2 * math.pi))
    z: FloatArray = np.float64(riser) * level[np.clip(np.searchsorted(at, X + bend) - 1, 0, 29)]
    return z, np.array(cv2.GaussianBlur(z.astype(np.float32), (0, 0), 10), dtype=np.float64)


def _fold(level: IntArray, most: int) -> IntArray:
    """Return a walk in steps of one that turns round at -most and most."""
    folded: IntArray = most - np.abs((level + most) % (4 * most) - 2 * most)
    return -folded


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
    """Dig bowls (n, 3), x, y, radius, with rims, at nodes of x and y.

    Where two overlap, the larger counts.

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
