"""Paths of walkers: straight legs over free ground between way points that are drawn at random."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.errors import SimulationError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.kernels import njit
from lirs_wct.navigation.spawn_poses import largest_area
from lirs_wct.world import World

CLEARANCE = 0.45
"""Meters that a walker's middle keeps from walls, steep ground and the border."""
MAX_SLOPE = math.radians(25)
"""Steepest ground that walkers walk on."""
RESOLUTION = 0.2
"""Cells of the free ground, meters."""
WAY_POINTS = 6
"""Way points of a path."""
LEG = (3.0, 10.0)
"""Shortest and longest leg, meters; where none is free in any of the directions tried, a path ends."""
TRIES = 24
"""Legs tried from a way point."""

Disc = tuple[float, float, float]
"""x, y, radius; meters."""


def walkable_ground(world: World) -> OccupancyGrid:
    """Return where walkers can be: the largest connected area of a world that is free for them.

    Raises:
        SimulationError: there is none.
    """
    free = world.traversable(clearance=CLEARANCE, max_slope=MAX_SLOPE, resolution=RESOLUTION)
    area = largest_area(free.free)
    if not area.any():
        raise SimulationError(f"{world.name}: no ground is free for walkers")
    return OccupancyGrid.from_mask(~area, free.resolution, free.origin)


def draw_paths(
    ground: OccupancyGrid, count: int, rng: np.random.Generator, keep_out: Iterable[Disc] = ()
) -> FloatArray:
    """Return (count, WAY_POINTS, 2) way points, x and y; the legs between them lie on free ground.

    A path that ends early has its last way point again.

    Args:
        ground: from `walkable_ground`.
        count: of paths.
        rng: of the way points.
        keep_out: discs that no path enters.

    Raises:
        SimulationError: the discs leave no free ground.
    """
    free = ground.free.copy()
    x, y = ground.centers(np.argwhere(free)).T
    inside = np.zeros(len(x), np.bool_)
    for disc_x, disc_y, radius in keep_out:
        inside |= np.hypot(x - disc_x, y - disc_y) < radius
    free[free] = ~inside
    cells = np.argwhere(free)
    if len(cells) == 0:
        raise SimulationError("no ground is free for walkers beside the robot and what stands there")
    paths = np.empty((count, WAY_POINTS, 2))
    first = cells[rng.integers(len(cells), size=count)]
    _extend_paths(free, ground.resolution, first, rng.random((count, WAY_POINTS - 1, TRIES, 2)), paths)
    corner = np.array((ground.origin.x, ground.origin.y))
    moved: FloatArray = paths + corner
    return moved


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _leg_is_free(free: BoolArray, resolution: float, x: float, y: float, to_x: float, to_y: float) -> bool:
    """Whether points at most a quarter of a cell apart all lie in free cells."""
    steps = math.ceil(4 * math.hypot(to_x - x, to_y - y) / resolution)
    for i in range(steps + 1):
        col = math.floor((x + (to_x - x) * i / steps) / resolution)
        row = math.floor((y + (to_y - y) * i / steps) / resolution)
        if row < 0 or col < 0 or row >= free.shape[0] or col >= free.shape[1] or not free[row, col]:
            return False
    return True
