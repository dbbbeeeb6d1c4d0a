"""Scan matcher of the original: hill climb over x, y and yaw, and likelihood."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.kernels import njit
from slam_baselines.gmapping.original.hit_maps import HitMap, cell_of
from slam_baselines.gmapping.patches import BITS, MASK

NULL_LIKELIHOOD = -0.5
"""Squared meters (negative) that a beam without a hit in its neighborhood counts as."""


class MatchingParameters(NamedTuple):
    """Parameters of the matcher, by the original's names; meanings as of GmappingOriginalConfig."""

    sigma: float
    kernelSize: int  # noqa: N815  the original's names
    lstep: float
    astep: float
    iterations: int
    lsigma: float


class HillClimbMatch(NamedTuple):
    """A matched scan.

    Attributes:
        pose: (3,) x, y, yaw of `T_map_base`; the expected one if the scan fits nowhere.
        log_likelihood: of the scan there.
    """

    pose: FloatArray
    log_likelihood: float


def match_scan(
    hits: HitMap, expected: FloatArray, ends: FloatArray, parameters: MatchingParameters
) -> HillClimbMatch:
    """Match a scan to a map.

    Args:
        hits: the map.
        expected: (3,) x, y, yaw of `T_map_base`, where the climb starts.
        ends: (n, 2) of beams in the base frame, meters.
        parameters: of the matcher.
    """
    found, score = _climb(hits, expected, ends, parameters)
    pose = found if score > 0 else expected
    return HillClimbMatch(pose, float(_score(hits, pose, ends, parameters)[1]))


@njit(cache=True, nogil=True)
def _climb(hits: Any, start: Any, ends: Any, parameters: Any) -> Any:
    """Climb to the best of six neighbors in halving steps; return pose and score."""
    _, _, linear, angular, iterations, _ = parameters
    pose, best, refinements = start.copy(), -1.0, 0
    score = _score(hits, pose, ends, parameters)[0]
    while True:
        if best >= score:
            refinements += 1
            linear, angular = linear / 2, angular / 2
        best, at = score, pose.copy()
        for axis, sign in ((0, 1), (0, -1), (1, -1), (1, 1), (2, 1), (2, -1)):
            neighbor = at.copy()
            neighbor[axis] += sign * (angular if axis == 2 else linear)
            there = _score(hits, neighbor, ends, parameters)[0]
            if there > score:
                score, pose = there, neighbor
        if score <= best and refinements >= iterations:
            return pose, best


@njit(cache=True, nogil=True)
def _score(hits: Any, pose: Any, ends: Any, parameters: Any) -> Any:
    """Return the score of the climb and the log-likelihood of a particle.

    A beam counts by the nearest mean of hits in the cells around its end. In the paper the cell before must
    be free; the original's test looks outside the map and always passes.
    """
    sigma, kernel, _, _, _, lsigma = parameters
    table, corner, patches, delta = hits
    counts, sums, rows, cols = patches.counts, patches.sums, table.shape[0] << BITS, table.shape[1] << BITS
    top, left = corner[0] << BITS, corner[1] << BITS
    c, s = math.cos(pose[2]), math.sin(pose[2])
    score = log_likelihood = 0.0
    for i in range(len(ends)):
        x = pose[0] + c * ends[i, 0] - s * ends[i, 1]
        y = pose[1] + s * ends[i, 0] + c * ends[i, 1]
        row0, col0, nearest = cell_of(y, delta) - top, cell_of(x, delta) - left, np.inf
        for row in range(max(row0 - kernel, 0), min(row0 + kernel + 1, rows)):
            for col in range(max(col0 - kernel, 0), min(col0 + kernel + 1, cols)):
                p, cell = table[row >> BITS, col >> BITS], ((row & MASK) << BITS) | (col & MASK)
                if p >= 0 and counts[p, cell] > 0:
                    share = 1.0 / counts[p, cell]
                    dx, dy = x - sums[p, cell, 0] * share, y - sums[p, cell, 1] * share
                    nearest = min(nearest, dx * dx + dy * dy)
        if nearest < np.inf:
            score += math.exp(-nearest / sigma)
            log_likelihood -= nearest / lsigma
        else:
            log_likelihood += NULL_LIKELIHOOD / lsigma
    return score, log_likelihood
