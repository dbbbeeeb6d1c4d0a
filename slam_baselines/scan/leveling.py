"""Scan leveling: ends of beams in the gravity-aligned base frame, with their heights.

The leveled frame has its origin in base_link, z against gravity and x along the robot's heading, so
`p_level = Ry(pitch) Rx(roll) T_base_laser p_laser`; the planar pose `T_map_base` does the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import Imu, LaserScan, Pose2, Pose3
from lirs_wct.kernels import njit


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
    """A scan in the leveled base frame, meters.

    Attributes:
        origin: (3,) the laser.
        hits: (n, 3) ends of beams with return.
        free: (m, 3) ends of the free part of beams without return.
        ground_slope: (2,) rise of the ground under the robot per meter forward and to the left.
        tilt: angle between the robot's z and gravity, radians; NaN where no attitude was given.
        stamp: seconds.
    """

    origin: FloatArray
    hits: FloatArray
    free: FloatArray
    ground_slope: tuple[float, float]
    tilt: float
    stamp: float

    @property
    def leveled(self) -> bool:
        """Whether an attitude was known."""
        return not math.isnan(self.tilt)

    def transformed(self, T_map_base: Pose2, height: float) -> ScanPoints:
        """Return the points in the map frame, the base being at `height`."""
        T, out = T_map_base, ScanPoints(np.empty(3), np.empty_like(self.hits), np.empty_like(self.free))
        _transform(ScanPoints(self.origin, self.hits, self.free), (T.x, T.y, T.yaw, height), out)
        return out


class ScanLeveler:
    """Leveling of one sensor's scans; keeps the directions of its beams and its mount."""

    def __init__(self, clear_range: float = 0.0, max_range: float = math.inf) -> None:
        """Use beams without return up to `clear_range`, and hits up to `max_range`, meters."""
        self._clear_range = clear_range
        self._max_range = max_range
        self._geometry: tuple[float, ...] = ()
        self._directions: FloatArray = np.empty((0, 2))
        self._limits = RangeLimits(0.0, 0.0, 0.0)
        self._T_base_laser = Pose3()
        self._mount = Mount(self._T_base_laser.rotation, self._T_base_laser.position)

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
        tilt = math.nan if imu is None else math.acos(min(1.0, math.cos(roll) * math.cos(pitch)))
        return LeveledScan(origin, ends[:hits], ends[len(ends) - free :], slope, tilt, scan.stamp)

    def _know(self, scan: LaserScan) -> None:
        """Update the sensor's beam directions, limits and mount if they changed."""
        geometry = (len(scan.ranges), scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        if geometry != self._geometry:
            self._geometry = geometry
            self._directions = np.stack((np.cos(scan.angles), np.sin(scan.angles)), axis=-1)
            farthest = min(scan.range_max, self._max_range)
            self._limits = RangeLimits(scan.range_min, farthest, min(farthest, self._clear_range))
        T = scan.T_base_laser
        if T is not self._T_base_laser and self._T_base_laser != T:
            self._T_base_laser, self._mount = T, Mount(T.rotation, T.position)


class RangeLimits(NamedTuple):
    """Ranges in meters: nearest hit, farthest hit, free part of a beam without return."""

    nearest: float
    farthest: float
    clear: float


class Mount(NamedTuple):
    """Rotation (3, 3) and position (3,) of the laser in the base frame."""

    rotation: FloatArray
    position: FloatArray


@njit(cache=True, nogil=True)
def _transform(scan: Any, pose: Any, out: Any) -> None:
    """Fill `out` with a scan turned and shifted by a pose (x, y, yaw, z)."""
    x, y, yaw, z = pose
    c, s = np.cos(yaw), np.sin(yaw)
    origin, new_origin = scan.origin.reshape(1, 3), out.origin.reshape(1, 3)
    for old, new in ((origin, new_origin), (scan.hits, out.hits), (scan.free, out.free)):
        for i in range(len(old)):
            u, v = old[i, 0], old[i, 1]
            new[i, 0], new[i, 1], new[i, 2] = x + c * u - s * v, y + s * u + c * v, z + old[i, 2]


@njit(cache=True, nogil=True)
def _level(
    ranges: Any, directions: Any, mount: Any, limits: Any, attitude: Any, ends: Any, origin: Any
) -> tuple[int, int]:
    """Fill `ends` with hits from the top and free ends from the bottom; return both counts."""
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
