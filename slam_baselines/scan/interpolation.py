"""Density of a scan's points: interpolation along surfaces, voxel filter.

A single scan draws a far wall as dots, since its beams are farther apart than cells. Dense scans fill the
gaps. If the robot travels a meter between two scans, only the dots remain to match, and they attract the next
scan's dots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.field_validators import require_above, require_within
from lirs_wct.kernels import njit
from slam_baselines.scan.leveling import ScanPoints


@dataclass(frozen=True, kw_only=True)
class InterpolationConfig:
    """Conditions for neighboring hits on one surface.

    Attributes:
        max_gap: largest distance between them, meters.
        max_obliqueness: largest ratio of that distance to the distance of the two beams there.
        max_bend: largest angle between their line and that through the hit before or after, radians.

    Raises:
        ConfigError: a value that is not above 0, or a ratio below 1.
    """

    max_gap: float = 1.0
    max_obliqueness: float = 3.0
    max_bend: float = 0.35

    def __post_init__(self) -> None:
        require_above(self, 0, "max_gap", "max_bend", of="the interpolation")
        require_within(self, "[1, inf)", "max_obliqueness", of="the interpolation")


def interpolate_hits(
    scan: ScanPoints, min_slopes: ByteArray, spacing: float, config: InterpolationConfig
) -> tuple[ScanPoints, ByteArray]:
    """Return the scan with hits `spacing` apart along surfaces, and their minimum slopes.

    Args:
        scan: in any frame; its hits in the order of the beams.
        min_slopes: (n,) of each hit; a hit between two others has the smaller of theirs.
        spacing: meters.
        config: conditions for hits on one surface.
    """
    c, count = config, np.zeros(len(scan.hits), np.int64)
    limits = c.max_gap, c.max_obliqueness, math.cos(c.max_bend)
    _count_between(scan.origin, scan.hits, spacing, limits, count)
    if not count.any():
        return scan, min_slopes
    hits, slopes = np.empty((len(count) + count.sum(), 3)), np.empty(len(count) + count.sum(), np.uint8)
    _fill(scan.hits, min_slopes, count, hits, slopes)
    return ScanPoints(scan.origin, hits, scan.free), slopes


@njit(cache=True, nogil=True)
def _count_between(origin: Any, hits: Any, spacing: float, limits: Any, count: Any) -> None:
    """Fill `count` (n,) with the number of hits to insert after each."""
    max_gap, max_obliqueness, straight = limits
    n = len(hits)
    for i in range(n - 1):
        dx, dy = hits[i + 1, 0] - hits[i, 0], hits[i + 1, 1] - hits[i, 1]
        gap = np.hypot(dx, dy)
        if gap <= spacing or gap > max_gap:
            continue
        ax, ay = hits[i, 0] - origin[0], hits[i, 1] - origin[1]
        bx, by = hits[i + 1, 0] - origin[0], hits[i + 1, 1] - origin[1]
        apart = abs(ax * by - ay * bx) / max(np.hypot(ax, ay), np.hypot(bx, by), 1e-6)
        if gap > max_obliqueness * apart:
            continue
        for j, k in ((i - 1, i), (i + 1, i + 2)):
            if j < 0 or k >= n:
                continue
            ex, ey = hits[k, 0] - hits[j, 0], hits[k, 1] - hits[j, 1]
            length = np.hypot(ex, ey)
            if 0 < length <= 2 * max_gap and dx * ex + dy * ey >= straight * gap * length:
                count[i] = int(gap / spacing)


@njit(cache=True, nogil=True)
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
