"""Brute force: every ray against every triangle and every wall cell, in double precision."""

import math

import numpy as np
from numpy.typing import NDArray

from lirs_wct.geometry import HeightField, WallGrid

Array = NDArray[np.float64]


def triangles_of(surface: HeightField) -> Array:
    """(m, 3, 3) corners of both triangles of every cell, diagonal south-west to north-east."""
    z = surface.z.astype(np.float64)
    rows, cols = z.shape
    x = surface.origin[0] + surface.cell[0] * np.arange(cols)
    y = surface.origin[1] + surface.cell[1] * np.arange(rows)[::-1]
    nodes = np.stack((*np.meshgrid(x, y), z), axis=-1)
    sw, se, nw, ne = nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, :-1], nodes[:-1, 1:]
    both = np.stack((np.stack((sw, se, ne), axis=2), np.stack((sw, ne, nw), axis=2)), axis=2)
    return both.reshape(-1, 3, 3)


def triangle_ranges(
    triangles: Array,
    origins: Array,
    directions: Array,
    *,
    grow: float = 0.0,
    grazing: float = -1.0,
    max_range: float = math.inf,
) -> Array:
    """(n,) range to the nearest triangle (Moeller and Trumbore 1997), both sides, inf = none.

    `grow` widens each triangle in barycentric coordinates (below 0: shrinks it), so that what lies between
    the answers of a little more and a little less is a matter of rounding. A triangle is left out where the
    ray lies in its plane: starts within `grazing` meters of it, and rises out of it by no more a meter.
    """
    a = triangles[:, 0]
    e1, e2 = triangles[:, 1] - a, triangles[:, 2] - a
    normal = np.cross(e1, e2)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    nearest = np.full(len(directions), np.inf)
    for k in range(0, len(directions), 256):
        o, d = origins[k : k + 256, None], directions[k : k + 256, None]
        p = np.cross(d, e2)
        with np.errstate(all="ignore"):
            inverse = 1 / np.einsum("nmk,mk->nm", p, e1)
            s = o - a
            u = np.einsum("nmk,nmk->nm", s, p) * inverse
            q = np.cross(s, e1)
            v = np.einsum("nmk,nmk->nm", np.broadcast_to(d, q.shape), q) * inverse
            t = np.einsum("nmk,mk->nm", q, e2) * inverse
            hit = (u >= -grow) & (v >= -grow) & (u + v <= 1 + grow) & (t >= 0) & (t <= max_range)
        if grazing >= 0:
            hit &= np.maximum(abs((s * normal).sum(axis=2)), abs((d * normal).sum(axis=2))) > grazing
        nearest[k : k + 256] = np.where(hit, t, np.inf).min(axis=1)
    return nearest


def wall_ranges(walls: WallGrid, origins: Array, directions: Array, *, grow: float = 0.0) -> Array:
    """(n,) range to the nearest wall cell as a closed box (slab method), inf = none; `grow` in meters."""
    rows, cols = np.nonzero(walls.solid)
    low = np.stack((cols, rows, 0 * rows), axis=1) * walls.resolution - grow
    high = np.stack((cols + 1, rows + 1, 0 * rows), axis=1) * walls.resolution + grow
    high[:, 2] += walls.height
    c, s = math.cos(walls.origin.yaw), math.sin(walls.origin.yaw)
    R = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
    o = (origins - (walls.origin.x, walls.origin.y, 0.0)) @ R.T
    d = directions @ R.T
    nearest = np.full(len(d), np.inf)
    for k in range(len(d)):
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (low - o[k]) / d[k], (high - o[k]) / d[k]
        inside = (low <= o[k]) & (o[k] <= high)
        parallel = d[k] == 0
        enter = np.where(parallel, np.where(inside, -np.inf, np.inf), np.minimum(a, b)).max(axis=1)
        leave = np.where(parallel, np.where(inside, np.inf, -np.inf), np.maximum(a, b)).min(axis=1)
        hit = (enter <= leave) & (leave >= 0)
        nearest[k] = np.where(hit, np.maximum(enter, 0), np.inf).min(initial=np.inf)
    return nearest
