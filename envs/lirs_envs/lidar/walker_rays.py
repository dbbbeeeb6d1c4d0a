"""Rays against walkers: upright capsules, all of one size."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.walkers import HALF_LENGTH, RADIUS
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.kernels import njit

BLOCK = 16
"""Number of neighboring rays tested together: they mostly miss a walker together."""
SAME = 1e-5
"""Tolerance of equal ranges to a walker, meters: MuJoCo's and the builtin rays round differently."""


@njit(cache=True, nogil=True, error_model="numpy")
def meet_walkers(
    centers: FloatArray,
    origins: FloatArray,
    directions: FloatArray,
    max_range: float,
    ranges: FloatArray,
    nearest: FloatArray,
    met: BoolArray,
) -> None:
    """Fill `nearest` with the nearer of `ranges` and walkers, `met` with walker hits.

    Args:
        centers: (m, 3) middles of the walkers.
        origins: (1, 3) of all rays, or (n, 3) of each.
        directions: (n, 3) unit vectors.
        max_range: meters.
        ranges: (n,) to all else, perhaps to the walkers as well; inf where nothing is within `max_range`.
        nearest: (n,).
        met: (n,).
    """
    nearest[:] = np.inf
    if len(origins) == 1:
        _cast_fan(centers, origins[0], directions, max_range, nearest)
    else:
        for k in range(len(directions)):
            _cast_fan(centers, origins[k], directions[k : k + 1], max_range, nearest[k : k + 1])
    for k in range(len(directions)):
        met[k] = nearest[k] < np.inf and nearest[k] <= ranges[k] + SAME
        nearest[k] = min(nearest[k], ranges[k])


def capsule_normals(centers: FloatArray, points: FloatArray) -> FloatArray:
    """Return (n, 3) normals of the walkers nearest to points (n, 3) on them, not normalized."""
    offsets = points[:, None] - centers
    offsets[..., 2] -= np.clip(offsets[..., 2], -HALF_LENGTH, HALF_LENGTH)
    nearest = np.square(offsets).sum(axis=2).argmin(axis=1)
    normals: FloatArray = offsets[np.arange(len(points)), nearest]
    return normals


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_fan(
    centers: FloatArray, origin: FloatArray, directions: FloatArray, max_range: float, nearest: FloatArray
) -> None:
    """Shorten `nearest` (n,) of rays from one origin."""
    n = len(directions)
    blocks = -(-n // BLOCK)
    cones = np.empty((blocks, 3))
    for j in range(blocks):
        _bound_block(directions[j * BLOCK : min((j + 1) * BLOCK, n)], cones[j])
    for m in range(len(centers)):
        x, y, z = origin[0] - centers[m, 0], origin[1] - centers[m, 1], origin[2] - centers[m, 2]
        distance = math.sqrt(x * x + y * y)
        if distance - RADIUS > max_range:
            continue
        # Half the horizontal angle of the walker.
        sine = RADIUS / distance if distance > RADIUS else 1.0
        cosine = math.sqrt(1.0 - sine * sine)
        for j in range(blocks):
            towards = -(x * cones[j, 0] + y * cones[j, 1]) / distance if distance > RADIUS else 1.0
            spread = cones[j, 2]
            if towards < cosine * spread - sine * math.sqrt(1.0 - spread * spread):
                continue
            for k in range(j * BLOCK, min((j + 1) * BLOCK, n)):
                hit = _capsule_range(x, y, z, directions[k, 0], directions[k, 1], directions[k, 2])
                if hit <= max_range and hit < nearest[k]:
                    nearest[k] = hit


@njit(cache=True, nogil=True, error_model="numpy")
def _bound_block(directions: FloatArray, cone: FloatArray) -> None:
    """Fill a cone with the mean horizontal direction of rays and the least cosine.

    Rays that do not keep within a quarter turn of it, upright ones among them, get the whole circle.
    """
    cone[0], cone[1], cone[2] = 1.0, 0.0, -1.0
    x, y = directions[:, 0].sum(), directions[:, 1].sum()
    length = math.sqrt(x * x + y * y)
    if length < 1e-9:
        return
    x, y, least = x / length, y / length, 1.0
    for k in range(len(directions)):
        flat = math.sqrt(directions[k, 0] ** 2 + directions[k, 1] ** 2)
        if flat < 1e-9:
            return
        least = min(least, (directions[k, 0] * x + directions[k, 1] * y) / flat)
    if least > 0.0:
        # Rounding leaves no ray outside.
        cone[0], cone[1], cone[2] = x, y, least - 1e-9


@njit(cache=True, nogil=True, error_model="numpy")
def _capsule_range(x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    """Return the distance of a ray's first hit on the capsule, else inf.

    The start (x, y, z) is relative to the capsule's center.
    """
    nearest = np.inf
    flat, along = dx * dx + dy * dy, x * dx + y * dy
    if flat > 0.0:
        root = along * along - flat * (x * x + y * y - RADIUS * RADIUS)
        if root >= 0.0:
            for side in (-1.0, 1.0):
                t = (-along + side * math.sqrt(root)) / flat
                if t >= 0.0 and abs(z + t * dz) <= HALF_LENGTH:
                    nearest = min(nearest, t)
    for end in (-1.0, 1.0):
        h = z - end * HALF_LENGTH
        b = along + h * dz
        root = b * b - (x * x + y * y + h * h - RADIUS * RADIUS)
        if root >= 0.0:
            for side in (-1.0, 1.0):
                t = -b + side * math.sqrt(root)
                if t >= 0.0 and end * (h + t * dz) >= 0.0:
                    nearest = min(nearest, t)
    return nearest
