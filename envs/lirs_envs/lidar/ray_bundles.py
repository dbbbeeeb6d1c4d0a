"""How far a bundle of neighboring beams goes before any of them can meet the ground.

The beams of a bundle start at one point. Interval arithmetic on their directions gives the box of cells that
they are over along a stretch, and the lowest height that one of them has there: above the maximum of the
mipmap's squares under that box, none meets anything. What many beams have in common is so asked once.
"""

from __future__ import annotations

import numpy as np

from lirs_envs.lidar.mipmap import LEAF, TerrainMipmap
from lirs_wct.arrays import FloatArray
from lirs_wct.kernels import njit

BUNDLE = 16
"""Beams of a bundle: 8 are a third more questions, 32 spread over too much ground."""
SMALLEST_FIELD = 400
"""Cells along the shorter side from which bundles gain; a ray crosses a smaller field in a few steps."""
CLEARANCE = 1e-6
"""Meters by which beams stay above a bound, far more than rounding."""


@njit(cache=True, error_model="numpy")
def safe_distance(
    terrain: TerrainMipmap, start: tuple[float, float, float], directions: FloatArray, max_range: float
) -> float:
    """Return a distance within which no beam of a bundle meets the ground, meters, at most `max_range`.

    Args:
        terrain: that the bundle is above.
        start: u, v, w: in cells from the south-west node, over the field, and meters up.
        directions: (n, 3) unit vectors.
        max_range: meters.
    """
    (u, v, w), (nx, ny) = start, terrain.cells
    per_x, per_y = 1.0 / terrain.frame[2], 1.0 / terrain.frame[3]
    least_u, most_u, least_v, most_v, least_w = np.inf, -np.inf, np.inf, -np.inf, np.inf
    for k in range(len(directions)):
        du, dv = directions[k, 0] * per_x, directions[k, 1] * per_y
        least_u, most_u = min(least_u, du), max(most_u, du)
        least_v, most_v = min(least_v, dv), max(most_v, dv)
        least_w = min(least_w, directions[k, 2])
    speed = max(-least_u, most_u, -least_v, most_v)
    if speed <= 0.0:
        return 0.0
    # From there on the fastest beam is beyond the border.
    reach, per_cell = min(max_range, (nx + ny) / speed), 1.0 / speed
    # Not `LEAF` alone: of a literal Numba would compile `_highest` once more.
    top, level, t = len(terrain.width) - 1, int(np.int64(LEAF)), 0.0
    while t < reach:
        t_out = min(t + (1 << level) * per_cell, reach)
        west, east = u + min(least_u * t, least_u * t_out), u + max(most_u * t, most_u * t_out)
        south, north = v + min(least_v * t, least_v * t_out), v + max(most_v * t, most_v * t_out)
        if west > nx or east < 0.0 or south > ny or north < 0.0:
            return max_range
        box = (max(int(west), 0), max(int(south), 0), min(int(east), nx - 1), min(int(north), ny - 1))
        if w + min(least_w * t, least_w * t_out) > _highest(terrain, box, level) + CLEARANCE:
            t, level = t_out, min(level + 1, top)
        elif level > LEAF:
            level -= 1
        else:
            break
    return t


@njit(cache=True, error_model="numpy", forceinline=True)
def _highest(terrain: TerrainMipmap, box: tuple[int, int, int, int], level: int) -> float:
    """Return the highest bound of a level's squares that hold a box of cells: west, south, east, north."""
    # Unsigned: an index that might be negative costs a comparison.
    row, highest = np.uint64(level), np.float32(-np.inf)
    first, width = terrain.start[row], terrain.width[row]
    west, south, east, north = box
    for r in range(south >> level, (north >> level) + 1):
        for c in range(west >> level, (east >> level) + 1):
            highest = max(highest, terrain.bound[np.uint64(first + r * width + c)])
    return np.float64(highest)
