"""Range data of a scan and their voxel filters, as in the original's sensor package.

Coordinates are float32, as in the original. Each voxel keeps one point, drawn by a generator with a fixed
start (reservoir sampling), so that the same scan gives the same points.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from lirs_extensions.originals.cartographer.config import CartographerOriginalConfig
from lirs_wct.arrays import Float32Array, FloatArray, IntArray, njit
from lirs_wct.geometry import LaserScan, Pose2

UNSPLIT = 16
"""Elements that the sort of the C++ library does not split."""


class RangeData(NamedTuple):
    """Ends of beams in one frame, meters; the original draws all from the base.

    Attributes:
        origin: (2,) float32.
        returns: (n, 2) float32, hits.
        misses: (m, 2) float32, ends of the free part of beams without return.
    """

    origin: Float32Array
    returns: Float32Array
    misses: Float32Array

    def transform(self, pose: Pose2) -> RangeData:
        """Return the same data in the frame in which `pose` is given."""
        origin, returns, misses = (_transform(pose, points) for points in self)
        return RangeData(origin, returns, misses)

    def thin(self, size: float) -> RangeData:
        """Return one point a voxel of edge `size`, meters."""
        returns, misses = (voxel_filter(points, size) for points in (self.returns, self.misses))
        return RangeData(self.origin, returns, misses)


def read_scan(scan: LaserScan, config: CartographerOriginalConfig) -> RangeData:
    """Return a scan's data in the base frame, beams in the original's order."""
    c, mount = config, scan.T_base_laser.to_pose2()
    beams = np.flatnonzero(~np.isnan(scan.ranges) & (scan.ranges >= max(scan.range_min, c.min_range)))
    beams = beams[_sorted_order(len(beams))]
    ranges, angles = scan.ranges[beams].astype(np.float64), scan.angles[beams]
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    hit = (ranges < scan.range_max) & (ranges <= c.max_range)
    ends = ranges[hit, None] * directions[hit]
    free = c.missing_data_ray_length * directions[~hit]
    origin: Float32Array = np.zeros(2, np.float32)
    return RangeData(origin, *(_transform(mount, points) for points in (ends, free)))


@cache
def _sorted_order(count: int) -> IntArray:
    """Return the order (count,) in which the C++ library's unstable sort leaves equal elements.

    The original sorts the beams of a scan by their times, which are equal. The sort splits a range until it
    has at most 16 elements: it exchanges the first with the middle one, and reverses the others.
    """
    order = np.arange(count)

    def split(first: int, last: int) -> None:
        while last - first > UNSPLIT:
            middle = first + (last - first) // 2
            order[[first, middle]] = order[[middle, first]]
            order[first + 1 : last] = order[first + 1 : last][::-1].copy()
            cut = first + 1 + (last - first - 1) // 2
            split(cut, last)
            last = cut

    split(0, count)
    return order


def _transform(pose: Pose2, points: FloatArray | Float32Array) -> Float32Array:
    moved: Float32Array = pose.apply(points).astype(np.float32)
    return moved


def round_half_away(values: FloatArray | Float32Array) -> IntArray:
    """Return the nearest whole numbers; halves away from zero, as the C library rounds."""
    exact = values.astype(np.float64)
    whole: IntArray = np.trunc(exact + np.copysign(0.5, exact)).astype(np.int64)
    return whole


def voxel_filter(points: Float32Array, size: float) -> Float32Array:
    """Return one point of (n, 2) a voxel of edge `size`, in their order."""
    if len(points) == 0:
        return points
    cells = round_half_away(points / np.float32(size))
    _, voxel = np.unique(cells[:, 0] << 32 | cells[:, 1] & 0xFFFFFFFF, return_inverse=True)
    kept: Float32Array = points[_drawn(voxel, int(voxel.max()) + 1)]
    return kept


def adaptive_voxel_filter(points: Float32Array, config: CartographerOriginalConfig) -> Float32Array:
    """Return points of the coarsest voxels that keep enough, to a tenth of the edge."""
    c = config
    points = points[np.hypot(points[:, 0], points[:, 1]) <= c.adaptive_max_range]
    if len(points) <= c.adaptive_min_num_points:
        return points
    found = voxel_filter(points, c.adaptive_max_length)
    if len(found) >= c.adaptive_min_num_points:
        return found
    high = c.adaptive_max_length
    while high > 0.01 * c.adaptive_max_length:
        found = voxel_filter(points, low := high / 2)
        if len(found) >= c.adaptive_min_num_points:
            return _bisect_length(points, found, low, high, c.adaptive_min_num_points)
        high = low
    return found


def _bisect_length(
    points: Float32Array, found: Float32Array, low: float, high: float, enough: int
) -> Float32Array:
    """Return the points of the largest edge from `low` to `high` that keeps enough."""
    while (high - low) / low > 0.1:
        middle = (low + high) / 2
        candidate = voxel_filter(points, middle)
        if len(candidate) >= enough:
            low, found = middle, candidate
        else:
            high = middle
    return found


MULTIPLIER, MODULUS = 16807, 2147483647
"""Of the minimal standard generator (Park and Miller 1988)."""


@njit
def _drawn(voxel: Any, voxels: int) -> Any:
    """Return (n,) whether each point is the one that its voxel keeps.

    The k-th point of a voxel replaces the kept one with probability 1 / k; the draws from 1 to k reject the
    generator's last incomplete part, as the C++ library does.
    """
    count, kept = np.zeros(voxels, np.int64), np.zeros(voxels, np.int64)
    state = 1
    for i in range(len(voxel)):
        v = voxel[i]
        count[v] += 1
        k = count[v]
        drawn = k
        if k > 1:
            part = (MODULUS - 2) // k
            state = state * MULTIPLIER % MODULUS
            while state - 1 >= part * k:
                state = state * MULTIPLIER % MODULUS
            drawn = (state - 1) // part + 1
        if drawn == k:
            kept[v] = i
    mask = np.zeros(len(voxel), np.bool_)
    mask[kept] = True
    return mask
