"""Maps of hits of all particles, and the hill climb that matches scans to them.

Each cell holds the number and the mean of the beams' ends in it. As in the original, cell (0, 0) has its
center in the origin.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import Float32Array, FloatArray, Int32Array, IntArray, njit
from slam_baselines.gmapping.patches import ABSENT, BITS, CELLS, MASK, PatchTables, list_rows


class HitPatches(NamedTuple):
    """All patches of all maps of hits, cells in row order.

    Attributes:
        counts: (p, 256) int32, how many beams ended in a cell.
        sums: (p, 256, 2) float32, sum of the places where they ended, x and y in meters.
        owners: (p,) int32, how many maps point at the patch; 0 = free.
        free: (1 + p,) int32, how many patches are free, and then which.
    """

    counts: Int32Array
    sums: Float32Array
    owners: Int32Array
    free: Int32Array

    def list_free(self) -> None:
        """List the free patches; the lowest is taken first."""
        list_rows(self.free, self.owners > 0)


class HitMap(NamedTuple):
    """One particle's map for the kernels; void after the next change.

    Its table is (rows, cols), the corner that of PatchTables, and `delta` the edge of a cell, meters.
    """

    table: Int32Array
    corner: IntArray
    patches: HitPatches
    delta: float


class HitMaps(PatchTables[HitPatches]):
    """Maps of a set of particles; `maps[i]` is one of them for the kernels."""

    def __init__(self, particles: int, delta: float) -> None:
        """Start empty; `delta` is the edge of a cell, meters."""
        super().__init__(particles, delta, _resize(None, 256))

    def __getitem__(self, particle: int) -> HitMap:
        """Return one map for the kernels."""
        return HitMap(self.tables[particle], self.corner, self.patches, self.resolution)

    def register_scan(self, poses: FloatArray, ends: FloatArray) -> None:
        """Add one scan to every map, each from its own pose (particles, 3) of `T_map_base`.

        The ends of beams (n, 2) are in the base frame, meters.
        """
        reach = float(np.hypot(ends[:, 0], ends[:, 1]).max(initial=0.0)) + 2 * self.resolution
        self.cover(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
        done = 0
        while done < len(poses):
            if self.patches.free[0] < len(ends):
                size = len(self.patches.owners)
                self.patches = _resize(self.patches, size + max(len(ends), size // 4))
            done = _register(self.tables, self.corner, self.patches, self.resolution, poses, ends, done)


def _resize(old: HitPatches | None, size: int) -> HitPatches:
    """Return `size` patches; the first are the old ones."""
    new = HitPatches(
        np.empty((size, CELLS), np.int32),
        np.empty((size, CELLS, 2), np.float32),
        np.zeros(size, np.int32),
        np.empty(size + 1, np.int32),
    )
    if old is not None:
        for source, target in zip(old[:-1], new[:-1], strict=True):
            target[: len(source)] = source
    new.list_free()
    return new


@njit(inline="always")
def cell_of(x: float, delta: float) -> int:
    """Return a coordinate's cell: the nearest center, halves away from 0 as in C's `round`."""
    q = x / delta
    return math.floor(q + 0.5) if q >= 0 else -math.floor(0.5 - q)


@njit
def _register(tables: Any, corner: Any, patches: Any, delta: float, poses: Any, ends: Any, first: int) -> int:
    """Add a scan to the maps from `first` on until patches run out; return the count."""
    for k in range(first, len(poses)):
        if patches.free[0] < len(ends):
            return k
        table, x0, y0 = tables[k], poses[k, 0], poses[k, 1]
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(len(ends)):
            x, y = x0 + c * ends[i, 0] - s * ends[i, 1], y0 + s * ends[i, 0] + c * ends[i, 1]
            row, col = cell_of(y, delta), cell_of(x, delta)
            r, q = (row >> BITS) - corner[0], (col >> BITS) - corner[1]
            p = table[r, q]
            if p == ABSENT or patches.owners[p] != 1:
                p = _own(table, patches, r, q)
            cell = ((row & MASK) << BITS) | (col & MASK)
            patches.counts[p, cell] += 1
            patches.sums[p, cell, 0] += np.float32(x)
            patches.sums[p, cell, 1] += np.float32(y)
    return len(poses)


@njit
def _own(table: Any, patches: Any, row: int, col: int) -> Any:
    """Give a table its own patch, new or copied, at a place; return its index."""
    p = table[row, col]
    patches.free[0] -= 1
    q = patches.free[1 + patches.free[0]]
    if p == ABSENT:
        patches.counts[q] = 0
        patches.sums[q] = 0
    else:
        patches.owners[p] -= 1
        patches.counts[q] = patches.counts[p]
        patches.sums[q] = patches.sums[p]
    patches.owners[q] = 1
    table[row, col] = q
    return q


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


def match_scan(
    hits: HitMap, expected: FloatArray, ends: FloatArray, parameters: MatchingParameters
) -> tuple[FloatArray, float]:
    """Return the pose (3,) of a matched scan, or the expected `T_map_base`, and its log-likelihood.

    The ends of beams (n, 2) are in the base frame, meters.
    """
    found, score = _climb(hits, expected, ends, parameters)
    pose = found if score > 0 else expected
    return pose, float(_score(hits, pose, ends, parameters)[1])


@njit
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


@njit
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
