"""Which poses of two trajectories belong to the same moment."""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray

MAX_GAP = 0.02
"""Poses whose stamps differ by more than this (seconds) are not the same moment."""


def associated(
    first: FloatArray, second: FloatArray, *, max_gap: float = MAX_GAP
) -> tuple[IntArray, IntArray]:
    """Pair each stamp of the shorter list with the nearest of the longer, at most `max_gap` apart.

    Args:
        first: (n,) seconds, increasing.
        second: (m,) seconds, increasing.
        max_gap: seconds.

    Returns:
        Two index vectors of one length, into `first` and `second`.
    """
    if len(first) > len(second):
        j, i = associated(second, first, max_gap=max_gap)
        return i, j
    if len(first) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    near = nearest(second, first)
    kept = np.flatnonzero(np.abs(second[near] - first) <= max_gap)
    return kept.astype(np.int64), near[kept]


def nearest(stamps: FloatArray, wanted: FloatArray) -> IntArray:
    """Return (n,) which of the stamps (m,), increasing, is nearest; of two that are, the earlier."""
    after = np.minimum(np.searchsorted(stamps, wanted), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(wanted - stamps[before] <= stamps[after] - wanted, before, after).astype(np.int64)


def scan_coverage(scans: FloatArray, poses: FloatArray) -> float:
    """Return the share of scans with a pose at their stamp; 0 of no scans.

    A pose is at a scan's stamp where it is at most 0.02 s away, and nearer than half the scans' period: poses
    of every second scan cover half of them, however fast they follow each other.

    Args:
        scans: (n,) stamps of the scans, seconds, increasing.
        poses: (m,) stamps of the poses, seconds, increasing.
    """
    if len(scans) == 0 or len(poses) == 0:
        return 0.0
    steps = np.diff(scans)
    steps = steps[steps > 0]
    gap = min(MAX_GAP, 0.49 * float(np.median(steps))) if len(steps) else MAX_GAP
    return float((np.abs(poses[nearest(poses, scans)] - scans) <= gap).mean())
