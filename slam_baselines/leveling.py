"""Scan leveling: ends of beams in the gravity-aligned base frame, with their heights.

The leveled frame has its origin in base_link, z against gravity and x along the robot's heading, so
`p_level = Ry(pitch) Rx(roll) T_base_laser p_laser`; the planar pose `T_map_base` does the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.geometry import ByteArray, FloatArray, Imu, LaserScan, Pose2, Pose3, njit


class ScanPoints(NamedTuple):
    """The points of a leveled scan in one frame, meters.

    Attributes:
        origin: (3,) the laser.
        hits: (n, 3) ends of beams with return.
        free: (m, 3) ends of the free part of beams without return.
    """

    origin: FloatArray
    hits: FloatArray
    free: FloatArray


@dataclass(frozen=True, slots=True)
class LeveledScan:
    """Scan in the leveled base frame, meters; its points are those of ScanPoints.

    Attributes:
        ground_slope: (2,) rise of the ground under the robot per meter forward and to the left.
        leveled: Whether an attitude was given.
        stamp: Seconds.
    """

    origin: FloatArray
    hits: FloatArray
    free: FloatArray
    ground_slope: tuple[float, float]
    leveled: bool
    stamp: float

    def transformed(self, T_map_base: Pose2, height: float) -> ScanPoints:
        """Return the points in the map frame, the base being at `height`."""
        T, out = T_map_base, ScanPoints(np.empty(3), np.empty_like(self.hits), np.empty_like(self.free))
        leveled = (self.origin[None], self.hits, self.free)
        _transform(leveled, (T.x, T.y, T.yaw, height), (out.origin[None], out.hits, out.free))
        return out


class ScanLeveler:
    """Leveling of one sensor's scans; keeps the directions of its beams and its mount."""

    def __init__(self, clear_range: float = 0.0, max_range: float = math.inf) -> None:
        """Use beams without return up to `clear_range`, and hits up to `max_range`, meters."""
        self._clear_range = clear_range
        self._max_range = max_range
        self._geometry: tuple[float, ...] = ()
        self._directions: FloatArray = np.empty((0, 2))
        self._limits = 0.0, 0.0, 0.0
        self._T_base_laser = Pose3()
        self._mount = self._T_base_laser.rotation, self._T_base_laser.position

    def level(self, scan: LaserScan, imu: Imu | None) -> LeveledScan:
        """Return the scan in the leveled base frame; without IMU the base counts as level."""
        self._know(scan)
        roll, pitch = (0.0, 0.0) if imu is None else (imu.roll, imu.pitch)
        ends, origin = np.empty((len(scan.ranges), 3)), np.empty(3)
        ranges = scan.ranges
        if ranges.flags.writeable:  # one type for the kernel, whether the scan may be written to or not
            ranges = ranges.view()
            ranges.flags.writeable = False
        hits, free = _level(ranges, self._directions, self._mount, self._limits, (roll, pitch), ends, origin)
        # z of the base in the leveled frame is (sin p cos r, -sin r, cos p cos r).
        slope = (-math.tan(pitch), math.tan(roll) / math.cos(pitch))
        free_ends = ends[len(ends) - free :]
        return LeveledScan(origin, ends[:hits], free_ends, slope, imu is not None, scan.stamp)

    def _know(self, scan: LaserScan) -> None:
        """Update the sensor's beam directions, limits and mount if they changed."""
        geometry = (len(scan.ranges), scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        if geometry != self._geometry:
            self._geometry = geometry
            self._directions = np.stack((np.cos(scan.angles), np.sin(scan.angles)), axis=-1)
            nearest, farthest = scan.limits
            farthest = min(farthest, self._max_range)
            self._limits = nearest, farthest, min(farthest, self._clear_range)
        T = scan.T_base_laser
        if T is not self._T_base_laser and self._T_base_laser != T:
            self._T_base_laser, self._mount = T, (T.rotation, T.position)


@njit
def _transform(points: Any, pose: Any, out: Any) -> None:
    """Turn and shift points (n, 3) by a pose x, y, yaw, z into `out`."""
    x, y, yaw, z = pose
    c, s = np.cos(yaw), np.sin(yaw)
    for k in range(len(points)):
        old, new = points[k], out[k]
        for i in range(len(old)):
            u, v = old[i, 0], old[i, 1]
            new[i, 0], new[i, 1], new[i, 2] = x + c * u - s * v, y + s * u + c * v, z + old[i, 2]


@njit
def _level(
    ranges: Any, directions: Any, mount: Any, limits: Any, attitude: Any, ends: Any, origin: Any
) -> tuple[int, int]:
    """Fill `ends` with hits from the top, free ends from the bottom; return both counts.

    Limits, meters: nearest hit, farthest hit, free part of a beam without return.
    """
    nearest, farthest, clear = limits
    rotation, shift = mount
    roll, pitch = attitude
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    A = np.array(((cp, sp * sr, sp * cr), (0.0, cr, -sr), (-sp, cp * sr, cp * cr)))
    R = np.zeros((3, 2))
    for i in range(3):
        origin[i] = A[i, 0] * shift[0] + A[i, 1] * shift[1] + A[i, 2] * shift[2]
        for j in range(2):
            R[i, j] = A[i, 0] * rotation[0, j] + A[i, 1] * rotation[1, j] + A[i, 2] * rotation[2, j]
    hits = free = 0
    n = len(ranges)
    for i in range(n):
        r = float(ranges[i])
        if nearest <= r <= farthest:
            row = hits
            hits += 1
        elif r > nearest and clear > nearest:  # +inf, or beyond the limit: free up to `clear`
            r = clear
            free += 1
            row = n - free
        else:
            continue
        x, y = r * directions[i, 0], r * directions[i, 1]
        for k in range(3):
            ends[row, k] = R[k, 0] * x + R[k, 1] * y + origin[k]
    return hits, free


MAX_GAP = 1.0
"""Largest distance between neighboring hits on one surface, meters."""
MAX_OBLIQUENESS = 3.0
"""Largest ratio of that distance to the distance of the two beams there."""
MAX_BEND = 0.35
"""Largest angle between the line of two hits and that through the hit before or after, radians."""


def interpolate_hits(scan: ScanPoints, min_slopes: ByteArray, spacing: float) -> tuple[ScanPoints, ByteArray]:
    """Return the scan with hits `spacing` meters apart along surfaces, and their minimum slopes.

    A single scan draws a far wall as dots, since its beams are farther apart than cells. Dense scans fill the
    gaps. If the robot travels a meter between two scans, the next scan's dots are attracted by dots. Hits
    come in the order of the beams; one between two others has the smaller of their minimum slopes (n,).
    """
    count = np.zeros(len(scan.hits), np.int64)
    _count_between(scan.origin, scan.hits, spacing, math.cos(MAX_BEND), count)
    if not count.any():
        return scan, min_slopes
    hits, slopes = np.empty((len(count) + count.sum(), 3)), np.empty(len(count) + count.sum(), np.uint8)
    _fill(scan.hits, min_slopes, count, hits, slopes)
    return ScanPoints(scan.origin, hits, scan.free), slopes


@njit
def _count_between(origin: Any, hits: Any, spacing: float, straight: float, count: Any) -> None:
    """Fill `count` (n,) with the number of hits to insert after each."""
    n = len(hits)
    for i in range(n - 1):
        dx, dy = hits[i + 1, 0] - hits[i, 0], hits[i + 1, 1] - hits[i, 1]
        gap = np.hypot(dx, dy)
        if gap <= spacing or gap > MAX_GAP:
            continue
        ax, ay = hits[i, 0] - origin[0], hits[i, 1] - origin[1]
        bx, by = hits[i + 1, 0] - origin[0], hits[i + 1, 1] - origin[1]
        apart = abs(ax * by - ay * bx) / max(np.hypot(ax, ay), np.hypot(bx, by), 1e-6)
        if gap > MAX_OBLIQUENESS * apart:
            continue
        for j, k in ((i - 1, i), (i + 1, i + 2)):
            if j < 0 or k >= n:
                continue
            ex, ey = hits[k, 0] - hits[j, 0], hits[k, 1] - hits[j, 1]
            length = np.hypot(ex, ey)
            if 0 < length <= 2 * MAX_GAP and dx * ex + dy * ey >= straight * gap * length:
                count[i] = int(gap / spacing)


@njit
def _fill(hits: Any, slopes: Any, count: Any, out: Any, out_slopes: Any) -> None:
    """Copy hits (n, 3) and slopes (n,); insert `count` (n,) evenly spaced ones after each."""
    # Number by number: to assign to a slice, Numba first compiles the message of an error for two seconds.
    m = 0
    for i in range(len(hits)):
        for a in range(3):
            out[m, a] = hits[i, a]
        out_slopes[m] = slopes[i]
        m += 1
        for k in range(count[i]):
            share = (k + 1) / (count[i] + 1)
            for a in range(3):
                out[m, a] = hits[i, a] + share * (hits[i + 1, a] - hits[i, a])
            out_slopes[m] = min(slopes[i], slopes[i + 1])
            m += 1


def voxel_filter(points: FloatArray, size: float, max_points: int) -> FloatArray:
    """Return at most `max_points` points, the first of each square of the given size."""
    cells = np.floor(points[:, :2] / size).astype(np.int64)
    _, first = np.unique(cells[:, 0] * (1 << 20) + cells[:, 1], return_index=True)
    first.sort()
    stride = max(1, -(-len(first) // max_points))
    return np.asarray(points[first[::stride]], dtype=np.float64)
