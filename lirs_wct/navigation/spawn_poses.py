"""Where robots start: poses spread over the free ground."""

from __future__ import annotations

import math

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.navigation.areas import largest_area
from lirs_wct.navigation.traversability import distance_to

EDGE = 0.15
"""Share of the free area's extent, on each side, where no robot starts."""
VIEW = 1.0
"""Meters that are to be free ahead of a robot's center where it starts."""
FAR, DIRECTIONS = 20.0, 24
"""How far it looks for the longest view, and in how many directions."""


def spawn_poses(free: OccupancyGrid, count: int = 8, *, corridors: bool = False) -> tuple[Pose2, ...]:
    """Return up to `count` poses spread over the largest connected free area, the roomiest first.

    Each faces the middle of that area and lies in its inner part: at the edge of the world a robot
    sees little of it. Farthest-point sampling, so the same grid gives the same poses.

    Args:
        free: where a robot's center may be.
        count: most poses.
        corridors: whether one that would face a wall faces where its view is longest instead.
    """
    area = _inner(largest_area(free.free))
    points = free.centers(np.argwhere(area))
    if len(points) == 0:
        return ()
    room = distance_to(~area, free.resolution)[area]
    middle = points.mean(axis=0)
    first = int(np.argmax(np.minimum(room, 3.0) - 0.02 * np.hypot(*(points - middle).T)))
    chosen = _farthest(points, np.minimum(room, 2.0), first, min(count, len(points)))
    return tuple(_facing(free if corridors else None, points[i], middle) for i in chosen)


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


def _farthest(points: FloatArray, bonus: FloatArray, first: int, count: int) -> list[int]:
    """Return indices: each next point has the largest distance to those before, plus its bonus."""
    chosen = [first]
    gap = np.full(len(points), np.inf)
    while len(chosen) < count:
        gap = np.minimum(gap, np.hypot(*(points - points[chosen[-1]]).T))
        chosen.append(int(np.argmax(gap + bonus)))
    return chosen


def _facing(free: OccupancyGrid | None, point: FloatArray, target: FloatArray) -> Pose2:
    """Return the pose at a point that faces a target, or the longest view where something is in that way."""
    dx, dy = (target - point).tolist()
    yaw = math.atan2(dy, dx) if math.hypot(dx, dy) > 1e-9 else 0.0
    if free is not None and min(VIEW, math.hypot(dx, dy)) > _view(free, point, yaw, VIEW):
        directions = [2 * math.pi * k / DIRECTIONS - math.pi for k in range(DIRECTIONS)]
        yaw = max(directions, key=lambda direction: _view(free, point, direction, FAR))
    return Pose2(float(point[0]), float(point[1]), yaw)


def _view(free: OccupancyGrid, point: FloatArray, yaw: float, reach: float) -> float:
    """Return how many meters ahead of a point are free, at most `reach`."""
    steps = np.arange(0.0, reach + free.resolution / 2, free.resolution / 2)
    ahead = point + steps[:, None] * np.array((math.cos(yaw), math.sin(yaw)))
    rows, cols = free.cells(ahead).T
    inside = (rows >= 0) & (rows < free.shape[0]) & (cols >= 0) & (cols < free.shape[1])
    blocked = ~inside
    blocked[inside] = free.log_odds[rows[inside], cols[inside]] >= 0
    return float(steps[np.argmax(blocked)]) if blocked.any() else reach
