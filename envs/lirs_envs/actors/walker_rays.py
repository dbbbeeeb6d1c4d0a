"""Rays against walkers: upright capsules, all of one size."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lirs_envs.actors.walkers import HALF_LENGTH, RADIUS
from lirs_wct.arrays import FloatArray


def walker_ranges(
    centers: FloatArray, origins: FloatArray, directions: FloatArray, max_range: float
) -> FloatArray:
    """Return (n,) ranges to the nearest capsule (see `lirs_envs.lidar.ray_casting.Caster`).

    Args:
        centers: (m, 3) middles of the capsules.
        origins: (3,) of all rays, or (n, 3).
        directions: (n, 3) unit vectors.
        max_range: metres; inf where nothing is nearer.
    """
    ranges = np.full(len(directions), np.inf)
    _cast(centers, origins.reshape(-1, 3), directions, max_range, ranges)
    return ranges


@njit(cache=True, nogil=True, error_model="numpy")
def _cast(
    centers: FloatArray, origins: FloatArray, directions: FloatArray, max_range: float, ranges: FloatArray
) -> None:
    """Fill `ranges` (n,); origins are (1, 3) or (n, 3)."""
    if len(origins) == 1:
        _cast_fan(centers, origins[0], directions, max_range, ranges)
        return
    for k in range(len(directions)):
        _cast_fan(centers, origins[k], directions[k : k + 1], max_range, ranges[k : k + 1])


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_fan(
    centers: FloatArray, origin: FloatArray, directions: FloatArray, max_range: float, ranges: FloatArray
) -> None:
    """Shorten `ranges` (n,) of rays from one origin."""
    for m in range(len(centers)):
        x, y, z = origin[0] - centers[m, 0], origin[1] - centers[m, 1], origin[2] - centers[m, 2]
        outside = x * x + y * y - RADIUS * RADIUS
        if outside > 0.0 and math.sqrt(x * x + y * y) - RADIUS > max_range:
            continue
        for k in range(len(directions)):
            dx, dy = directions[k, 0], directions[k, 1]
            flat, along, beside = dx * dx + dy * dy, x * dx + y * dy, x * dy - y * dx
            # The ray passes the axis beyond the radius, or runs away from it.
            if beside * beside > RADIUS * RADIUS * flat or (outside > 0.0 and along >= 0.0):
                continue
            hit = _capsule_range(x, y, z, dx, dy, directions[k, 2])
            if hit <= max_range and hit < ranges[k]:
                ranges[k] = hit


@njit(cache=True, nogil=True, error_model="numpy")
def _capsule_range(x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    """Return where a ray from (x, y, z), relative to the middle, meets the capsule first, else inf."""
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
