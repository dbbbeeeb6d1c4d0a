"""Maps of hits of all particles: count and mean of beams' ends by cell.

The original matches scans against them. As there, cell (0, 0) has its center in the origin.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray, Int32Array, IntArray
from lirs_wct.kernels import njit
from slam_baselines.gmapping.patches import ABSENT, BITS, CELLS, MASK, HitPatches, PatchTables


class HitMap(NamedTuple):
    """One particle's map for the kernels; void after the next change.

    Attributes:
        table: (rows, cols) int32, the patch at each place.
        corner: (2,) int64, row and column of the table's first patch in the lattice of patches.
        patches: targets of the table.
        delta: edge of a cell, meters.
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
        """Add one scan to every map, each from its own pose.

        Args:
            poses: (particles, 3) x, y, yaw of `T_map_base`.
            ends: (n, 2) of beams in the base frame, meters.
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


@njit(cache=True, inline="always")
def cell_of(x: float, delta: float) -> int:
    """Return a coordinate's cell: the nearest center, halves away from 0 as in C's `round`."""
    q = x / delta
    return math.floor(q + 0.5) if q >= 0 else -math.floor(0.5 - q)


@njit(cache=True, nogil=True)
def _register(tables: Any, corner: Any, patches: Any, delta: float, poses: Any, ends: Any, first: int) -> int:
    """Add a scan to the maps from `first` on, until patches run out; return the number done."""
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


@njit(cache=True, nogil=True)
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
