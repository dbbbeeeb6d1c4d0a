"""A scan made level: ends of beams in the gravity-aligned base frame, with their heights.

The levelled frame has its origin in base_link, z against gravity and x along the robot's heading, so
`p_level = Ry(pitch) Rx(roll) T_base_laser p_laser`; the planar pose `T_map_base` does the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_wct.pose import Pose2, Pose3
from lirs_wct.scan import Imu, LaserScan

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LevelledScan:
    """A scan in the levelled base frame, metres.

    Attributes:
        origin: (3,) the laser.
        hits: (n, 3) where beams ended.
        free: (m, 3) where beams that met nothing were still free: the farthest that is believed of them.
        ground_slope: (2,) rise of the ground under the robot per metre forward and to the left.
        tilt: angle between the robot's z and gravity, radians; NaN where no attitude was given.
        stamp: seconds.
    """

    origin: Array
    hits: Array
    free: Array
    ground_slope: tuple[float, float]
    tilt: float
    stamp: float

    @property
    def levelled(self) -> bool:
        """Whether an attitude was known."""
        return not math.isnan(self.tilt)

    def placed(self, T_map_base: Pose2, height: float) -> tuple[Array, Array, Array]:
        """Return origin, hits and free ends in the map frame, the base being at `height`."""
        c, s = math.cos(T_map_base.yaw), math.sin(T_map_base.yaw)
        turn = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
        shift = np.array((T_map_base.x, T_map_base.y, height))
        return self.origin @ turn + shift, self.hits @ turn + shift, self.free @ turn + shift


class ScanLeveller:
    """Levels the scans of one sensor; keeps the directions of its beams."""

    def __init__(self, clear_range: float = 0.0, max_range: float = math.inf) -> None:
        """Believe beams without return up to `clear_range`, and no hit from `max_range` on, metres."""
        self._clear_range = clear_range
        self._max_range = max_range
        self._geometry: tuple[int, float, float] = (-1, 0.0, 0.0)
        self._directions: Array = np.empty((0, 2))

    def level(self, scan: LaserScan, imu: Imu | None) -> LevelledScan:
        """Return the scan in the levelled base frame; without IMU the base counts as level."""
        geometry = len(scan.ranges), scan.angle_min, scan.angle_increment
        if geometry != self._geometry:
            self._geometry = geometry
            self._directions = np.stack((np.cos(scan.angles), np.sin(scan.angles)), axis=-1)
        attitude = Pose3() if imu is None else Pose3.from_rpy(0, 0, 0, imu.roll, imu.pitch, 0)
        T = attitude @ scan.T_base_laser
        R, origin = T.rotation, T.position
        farthest = min(scan.range_max, self._max_range)
        clear = min(farthest, self._clear_range)
        ends = np.empty((len(scan.ranges), 3))
        hits, free = _ends(scan.ranges, self._directions, R, origin, scan.range_min, farthest, clear, ends)
        normal = attitude.rotation[:, 2]
        return LevelledScan(
            origin,
            ends[:hits],
            ends[len(ends) - free :],
            (-normal[0] / normal[2], -normal[1] / normal[2]),
            math.nan if imu is None else math.acos(min(1.0, normal[2])),
            scan.stamp,
        )


@njit(cache=True)
def _ends(ranges, directions, R, origin, nearest, farthest, clear, ends):
    """Fill `ends` with hits from its top and with free ends from its bottom; return how many of each."""
    hits = free = 0
    n = len(ranges)
    for i in range(n):
        r = float(ranges[i])
        if nearest <= r <= farthest:
            row = hits
            hits += 1
        elif r > nearest and clear > nearest:  # +inf, or beyond what is believed: free up to `clear`
            r = clear
            free += 1
            row = n - free
        else:
            continue
        x, y = r * directions[i, 0], r * directions[i, 1]
        for k in range(3):
            ends[row, k] = R[k, 0] * x + R[k, 1] * y + origin[k]
    return hits, free
