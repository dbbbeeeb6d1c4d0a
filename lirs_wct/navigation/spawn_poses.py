"""Where robots start: poses spread over the free ground."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.navigation.traversability import distance_to, largest_area

EDGE = 0.15
"""Share of the free area's extent, on each side, where no robot starts."""


def spawn_poses(free: OccupancyGrid, count: int = 8) -> tuple[Pose2, ...]:
    """Return up to `count` poses spread over the largest connected free area, the roomiest first.

    Each faces the middle of that area and lies in its inner part: at the edge of the world a robot
    sees little of it. Farthest-point sampling, so the same grid gives the same poses.
    """
    area = _inner(largest_area(free.free))
    points = free.centers(np.argwhere(area))
    if len(points) == 0:
        return ()
    room = distance_to(~area, free.resolution)[area]
    middle = points.mean(axis=0)
    first = int(np.argmax(np.minimum(room, 3.0) - 0.02 * np.hypot(*(points - middle).T)))
    chosen = _farthest(points, np.minimum(room, 2.0), first, min(count, len(points)))
    return tuple(_facing(points[i], middle) for i in chosen)


def _inner(area: BoolArray) -> BoolArray:
    """Return the part of an area that keeps off the ends of its extent, or all of it where none does."""
    inner = area.copy()
    for axis in (0, 1):
        filled = np.flatnonzero(area.any(axis=1 - axis))
        if len(filled) == 0:
            return area
        low, high = int(filled[0]), int(filled[-1])
        at = np.arange(area.shape[axis])
        outside = (at < low + EDGE * (high - low)) | (at > high - EDGE * (high - low))
        inner[(outside, slice(None)) if axis == 0 else (slice(None), outside)] = False
    return inner if inner.any() else area


@njit(cache=True)
def _farthest(points: FloatArray, bonus: FloatArray, first: int, count: int) -> IntArray:
    """Return (count,) indices: each next point has the largest distance to those before, plus its bonus."""
    chosen = np.empty(count, np.int64)
    gap = np.full(len(points), np.inf)
    best = first
    for k in range(count):
        chosen[k] = best
        x, y = points[best]
        best = 0
        for i in range(len(points)):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            gap[i] = min(gap[i], math.sqrt(dx * dx + dy * dy))
            if gap[i] + bonus[i] > gap[best] + bonus[best]:
                best = i
    return chosen


def _facing(point: FloatArray, target: FloatArray) -> Pose2:
    dx, dy = (target - point).tolist()
    return Pose2(float(point[0]), float(point[1]), math.atan2(dy, dx) if math.hypot(dx, dy) > 1e-9 else 0.0)
