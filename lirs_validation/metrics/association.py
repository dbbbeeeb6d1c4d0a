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
    after = np.clip(np.searchsorted(second, first), 0, len(second) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(second[after] - first) < np.abs(first - second[before]), after, before)
    kept = np.flatnonzero(np.abs(second[nearest] - first) <= max_gap)
    return kept.astype(np.int64), nearest[kept].astype(np.int64)
