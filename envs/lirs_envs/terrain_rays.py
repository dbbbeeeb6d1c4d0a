"""Rays against a height field: down and up its maximum-mipmap, then cell by cell.

The kernels are inlined into one: a call would count references to each array, which costs more than a step.
An unsigned index spares numba's look for a negative one.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_envs.clipping import FAR, clip, inverse
from lirs_envs.mipmap import Terrain

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Ray = tuple[float, float, float, float, float, float]
"""u, v, w: start, in cells from the south-west node and metres up; du, dv, dw: its change per metre."""
START_LEVEL = 6
"""Squares of 64 cells: the fastest start, measured from 257^2 to 4097^2."""
BORDER = 1e-9
"""Cells by which the border reaches out, so that rounding puts no ray on it outside."""


@njit(cache=True)
def terrain_ranges(
    terrain: Terrain, origin: Array, directions: Array, max_range: float, ranges: Array
) -> None:
    """Shorten `ranges` (n,) to the first triangle on each ray within `max_range`."""
    z, bound, start, width, frame = terrain.z, terrain.bound, terrain.start, terrain.width, terrain.frame
    nx, ny = z.shape[1] - 1, z.shape[0] - 1
    u, v, w = (origin[0] - frame[0]) / frame[2], (origin[1] - frame[1]) / frame[3], origin[2]
    low, high = frame[4] - frame[6], frame[5] + frame[6]
    for k in range(len(directions)):
        du, dv, dw = directions[k, 0] / frame[2], directions[k, 1] / frame[3], directions[k, 2]
        per_u, per_v = inverse(du), inverse(dv)
        t, t_end = clip(u, per_u, -BORDER, nx + BORDER, 0.0, min(max_range, ranges[k]))
        t, t_end = clip(v, per_v, -BORDER, ny + BORDER, t, t_end)
        t, t_end = clip(w, inverse(dw), low, high, t, t_end)
        if t <= t_end:
            hit = _follow(z, bound, start, width, (u, v, w, du, dv, dw), (per_u, per_v), t, t_end)
            ranges[k] = min(ranges[k], hit)


@njit(cache=True, forceinline=True)
def _follow(
    z: Floats,
    bound: Floats,
    start: NDArray[np.int64],
    width: NDArray[np.int64],
    ray: Ray,
    per: tuple[float, float],
    t: float,
    t_end: float,
) -> float:
    """Return where a ray meets the surface in [t, t_end], which lies in the field's box, else inf.

    Descends into a square of cells only where the ray, over its way through it, is not wholly above the
    square's maximum (from below: not wholly below its minimum). Cells are stepped in integers: rounding
    moves a crossing by 1e-12 cells and never loses one.
    """
    u, v, w, du, dv, dw = ray
    nx, ny, top = z.shape[1] - 1, z.shape[0] - 1, len(width) - 1
    i, j = min(max(int(u + t * du), 0), nx - 1), min(max(int(v + t * dv), 0), ny - 1)
    height = w + t * dw - _surface(z, i, j, u + t * du - i, v + t * dv - j)
    if height == 0.0:
        return t
    side = 1.0 if height > 0.0 else -1.0
    first = 0 if height > 0.0 else len(bound) // 2
    w, dw = side * w, side * dw
    per_u, per_v = per
    far_u, far_v = 0.0 if per_u != 0.0 else FAR, 0.0 if per_v != 0.0 else FAR
    east, north = 1 if du > 0.0 else 0, 1 if dv > 0.0 else 0
    level = min(top, START_LEVEL)
    while True:
        c, r = i >> level, j >> level
        tx = (((c + east) << level) - u) * per_u + far_u
        ty = (((r + north) << level) - v) * per_v + far_v
        t_out = max(t, min(tx, ty, t_end))
        square = first + start[level] + r * width[level] + c
        if level == 0:
            hit: float = _cell_range(z, i, j, (u, v, w, du, dv, dw), side, t, t_out)
            if hit < np.inf:
                return hit
        elif w + dw * (t if dw > 0.0 else t_out) <= bound[np.uint64(square)]:
            level -= 1
            continue
        if t_out >= t_end:
            return np.inf
        t = t_out
        if tx <= ty:
            i = ((c + east) << level) + east - 1
            j = min(max(int(v + t * dv), r << level), min(((r + 1) << level), ny) - 1)
        else:
            j = ((r + north) << level) + north - 1
            i = min(max(int(u + t * du), c << level), min(((c + 1) << level), nx) - 1)
        if i < 0 or j < 0 or i >= nx or j >= ny:
            return np.inf
        if level < top and ((i >> level) >> 1 != c >> 1 or (j >> level) >> 1 != r >> 1):
            level += 1


@njit(cache=True, forceinline=True)
def _surface(z: Floats, i: int, j: int, a: float, b: float) -> float:
    """Return the height of the surface in cell (j, i), a to the east and b to the north of its corner."""
    # float() of a float32 stays one in numba, and the differences below would be rounded to it.
    sw, ne = np.float64(z[j, i]), np.float64(z[j + 1, i + 1])
    # The diagonal runs from south-west to north-east: a = b.
    if a >= b:
        se = np.float64(z[j, i + 1])
        return sw + a * (se - sw) + b * (ne - se)
    nw = np.float64(z[j + 1, i])
    return sw + a * (ne - nw) + b * (nw - sw)


@njit(cache=True, forceinline=True)
def _cell_range(z: Floats, i: int, j: int, ray: Ray, side: float, t: float, t_out: float) -> float:
    """Return where a ray on `side` of the surface meets a cell's two triangles in [t, t_out], else inf.

    Over each triangle side * (ray - surface) is linear in t. It was above 0 before, so that a value of 0 or
    less at the end of a piece is a hit within it.
    """
    u, v, w, du, dv, dw = ray
    sw, se = np.float64(z[j, i]), np.float64(z[j, i + 1])
    nw, ne = np.float64(z[j + 1, i]), np.float64(z[j + 1, i + 1])
    a, b = u - i, v - j
    t_diagonal = (b - a) / (du - dv) if du != dv else t
    pieces = 2 if t < t_diagonal < t_out else 1
    for piece in range(pieces):
        begin = t_diagonal if piece == 1 else t
        end = t_diagonal if piece + 1 < pieces else t_out
        middle = 0.5 * (begin + end)
        if a + middle * du >= b + middle * dv:
            gx, gy = se - sw, ne - se
        else:
            gx, gy = ne - nw, nw - sw
        height = w - side * (sw + a * gx + b * gy)
        slope = dw - side * (du * gx + dv * gy)
        if height + end * slope <= 0.0:
            # Not falling, it was at 0 or less from the beginning, by rounding.
            return min(max(-height / slope, begin), end) if slope < 0.0 else begin
    return np.inf
