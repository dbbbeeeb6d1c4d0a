"""From cells to a path that a robot likes: evenly spaced, without corners, still free."""

from __future__ import annotations

import math

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.kernels import njit

SPACING = 0.1
"""Meters between the points of a path."""


def smoothed(
    points: FloatArray,
    grid: OccupancyGrid,
    room: FloatArray,
    *,
    keep: float,
    hold: int = 0,
    iterations: int = 250,
) -> FloatArray:
    """Pull a path tight like a rubber band that keeps its distance from what is blocked.

    Each iteration moves each point towards the middle of its neighbors (Laplacian smoothing) unless the
    new place has less room than before and less than `keep`.

    Args:
        points: (n, 2) meters in the grid's frame, in free cells.
        grid: the cells.
        room: (rows, cols) meters to the nearest blocked cell, 0 where blocked.
        keep: room in meters beyond which a point may move freely.
        hold: points at the beginning that stay where they are.
        iterations: how long to pull.
    """
    held = float(arc_length(points)[min(hold, len(points) - 1)])
    path = resampled(points, SPACING)
    if len(path) < 3:
        return path
    local = grid.origin.inverse().apply(path) / grid.resolution
    tight = _pull(np.ascontiguousarray(local), room, keep, 1 + round(held / SPACING), iterations)
    return resampled(grid.origin.apply(tight * grid.resolution), SPACING)


def resampled(points: FloatArray, spacing: float) -> FloatArray:
    """Return points about `spacing` apart along a polyline (n, 2), both ends kept."""
    arc = arc_length(points)
    if len(points) < 2 or arc[-1] < 1e-9:
        return points[:1].copy()
    kept = np.concatenate(([True], np.diff(arc) > 1e-9))
    count = max(2, math.ceil(arc[-1] / spacing - 1e-9) + 1)
    at = np.linspace(0.0, arc[-1], count)
    return np.column_stack([np.interp(at, arc[kept], points[kept, k]) for k in range(2)])


def arc_length(points: FloatArray) -> FloatArray:
    """Return (n,) meters along a polyline (n, 2)."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))


def curvature(points: FloatArray, baseline: int = 3) -> FloatArray:
    """Return (n,) 1/m: change of direction over `baseline` steps on both sides, by the distance."""
    n = len(points)
    i = np.arange(n)
    before, after = points[np.maximum(i - baseline, 0)], points[np.minimum(i + baseline, n - 1)]
    a, b = points - before, after - points
    turn = np.abs(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a * b, axis=1)))
    length = (np.linalg.norm(a, axis=1) + np.linalg.norm(b, axis=1)) / 2
    ends = (i == 0) | (i == n - 1) | (length < 1e-9)
    bend: FloatArray = np.where(ends, 0.0, turn / np.where(ends, 1.0, length))
    return bend


@njit(cache=True)
def _pull(points: FloatArray, room: FloatArray, keep: float, first: int, iterations: int) -> FloatArray:
    """Smooth points given in cells (column, row) from the first one on; the last stays."""
    rows, cols = room.shape
    p = points.copy()
    for _ in range(iterations):
        for k in range(first, len(p) - 1):
            x = p[k, 0] + 0.5 * (0.5 * (p[k - 1, 0] + p[k + 1, 0]) - p[k, 0])
            y = p[k, 1] + 0.5 * (0.5 * (p[k - 1, 1] + p[k + 1, 1]) - p[k, 1])
            c, r = math.floor(x), math.floor(y)
            if r < 0 or c < 0 or r >= rows or c >= cols:
                continue
            old = room[math.floor(p[k, 1]), math.floor(p[k, 0])]
            if room[r, c] > 0 and room[r, c] >= min(old, keep):
                p[k, 0], p[k, 1] = x, y
    return p
