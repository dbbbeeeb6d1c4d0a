"""Rays against the walls of a laser map: exact cells, with free space skipped by distance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from lirs_envs.clipping import FAR, clip, inverse
from lirs_wct.walls import WallGrid

Array = NDArray[np.float64]


class WallCells(NamedTuple):
    """Walls as the kernels read them.

    Attributes:
        distance: (rows, cols) uint8, row 0 = south: cells to the nearest wall cell in the larger of the two
            directions (0 = wall), at most 255; without walls (0, 0).
        frame: (6,) x and y of the outer corner of cell (0, 0), cosine and sine of the grid's yaw,
            resolution, height.
    """

    distance: NDArray[np.uint8]
    frame: NDArray[np.float64]


def wall_cells_of(walls: WallGrid | None) -> WallCells:
    """Build the distances to the walls; none when there is no wall cell."""
    if walls is None or not walls.solid.any():
        return WallCells(np.zeros((0, 0), np.uint8), np.zeros(6))
    distance = np.minimum(distance_transform_cdt(~walls.solid, metric="chessboard"), 255).astype(np.uint8)
    T = walls.origin
    frame = np.array((T.x, T.y, math.cos(T.yaw), math.sin(T.yaw), walls.resolution, walls.height))
    return WallCells(np.ascontiguousarray(distance), frame)


@njit(cache=True)
def wall_ranges(walls: WallCells, origin: Array, directions: Array, max_range: float, ranges: Array) -> None:
    """Fill `ranges` (n,) with the range of the first wall cell on each ray, inf = none within `max_range`."""
    ranges[:] = np.inf
    distance, frame = walls.distance, walls.frame
    if distance.size == 0:
        return
    ny, nx = distance.shape
    c, s, per_metre, height = frame[2], frame[3], 1.0 / frame[4], frame[5]
    x, y = origin[0] - frame[0], origin[1] - frame[1]
    u, v = (c * x + s * y) * per_metre, (c * y - s * x) * per_metre
    for k in range(len(directions)):
        du = (c * directions[k, 0] + s * directions[k, 1]) * per_metre
        dv = (c * directions[k, 1] - s * directions[k, 0]) * per_metre
        per_u, per_v = inverse(du), inverse(dv)
        t, t_end = clip(u, per_u, 0.0, float(nx), 0.0, max_range)
        t, t_end = clip(v, per_v, 0.0, float(ny), t, t_end)
        t, t_end = clip(origin[2], inverse(directions[k, 2]), 0.0, height, t, t_end)
        if t <= t_end:
            ranges[k] = _first_wall(distance, (u, v, du, dv, per_u, per_v), t, t_end)


@njit(cache=True, forceinline=True)
def _first_wall(
    distance: NDArray[np.uint8], ray: tuple[float, float, float, float, float, float], t: float, t_end: float
) -> float:
    """Return where a ray enters the first wall cell in [t, t_end], else inf.

    Around a cell at distance d every cell nearer than d is free: the ray leaves that square in one step.
    At a corner it steps through one of the two neighbours, so that it never slips between two cells that
    touch at a corner only.
    """
    u, v, du, dv, per_u, per_v = ray
    ny, nx = distance.shape
    east, north = 1 if du > 0.0 else 0, 1 if dv > 0.0 else 0
    far_u, far_v = 0.0 if per_u != 0.0 else FAR, 0.0 if per_v != 0.0 else FAR
    i, j = min(max(int(u + t * du), 0), nx - 1), min(max(int(v + t * dv), 0), ny - 1)
    while True:
        free = np.int64(distance[j, i])  # int() of an unsigned stays unsigned in numba
        if free == 0:
            return t
        tx = ((i + free if east else i + 1 - free) - u) * per_u + far_u
        ty = ((j + free if north else j + 1 - free) - v) * per_v + far_v
        t = max(t, min(tx, ty))
        if t >= t_end:
            return np.inf
        if tx <= ty:
            j = min(max(int(v + t * dv), j + 1 - free, 0), j + free - 1, ny - 1)
            i += free if east else -free
        else:
            i = min(max(int(u + t * du), i + 1 - free, 0), i + free - 1, nx - 1)
            j += free if north else -free
        if i < 0 or j < 0 or i >= nx or j >= ny:
            return np.inf
