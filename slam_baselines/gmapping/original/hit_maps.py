"""Maps of hits of all particles: number and mean of the beams' ends in each cell.

The original matches scans against them. As there, a map consists of patches that particles share until one of
them writes (copy on write), and cell (0, 0) has its center in the origin.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import Float32Array, FloatArray, Int32Array, IntArray
from lirs_wct.kernels import njit

BITS = 4
PATCH = 1 << BITS
"""Cells along the edge of a patch."""
MASK = PATCH - 1
ABSENT = -1
"""Marks, in a table, a patch that no beam ended in."""


class HitPatches(NamedTuple):
    """All patches of all maps, cells in row order.

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


class HitMaps:
    """Maps of a set of particles over one growing lattice of cells."""

    def __init__(self, particles: int, delta: float) -> None:
        """Start empty; `delta` is the edge of a cell, meters."""
        self._delta = delta
        self._tables: Int32Array = np.empty((particles, 0, 0), np.int32)
        self._corner: IntArray = np.zeros(2, np.int64)
        self._patches = _resize(None, 256)

    def __getitem__(self, particle: int) -> HitMap:
        """Return one map for the kernels."""
        return HitMap(self._tables[particle], self._corner, self._patches, self._delta)

    @property
    def nbytes(self) -> int:
        """Memory of patches and tables."""
        return self._tables.nbytes + sum(a.nbytes for a in self._patches)

    @property
    def in_use(self) -> int:
        """Patches that at least one map points at."""
        return len(self._patches.owners) - int(self._patches.free[0])

    def descend(self, parents: IntArray) -> None:
        """Replace map i by a copy of the former map `parents[i]`; copies share their patches."""
        self._tables = self._tables[parents]
        owners = np.bincount(self._tables[self._tables != ABSENT], minlength=len(self._patches.owners))
        self._patches.owners[:] = owners
        _list_free(self._patches)

    def register_scan(self, poses: FloatArray, ends: FloatArray) -> None:
        """Add one scan to every map, each from its own pose.

        Args:
            poses: (particles, 3) x, y, yaw of `T_map_base`.
            ends: (n, 2) of beams in the base frame, meters.
        """
        reach = float(np.hypot(ends[:, 0], ends[:, 1]).max(initial=0.0)) + 2 * self._delta
        self._cover(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
        done = 0
        while done < len(poses):
            if self._patches.free[0] < len(ends):
                size = len(self._patches.owners)
                self._patches = _resize(self._patches, size + max(len(ends), size // 4))
            done = _register(self._tables, self._corner, self._patches, self._delta, poses, ends, done)

    def _cover(self, low: FloatArray, high: FloatArray) -> None:
        """Make the box (x, y in meters) part of the tables."""
        edge = PATCH * self._delta
        first = np.array([math.floor(v / edge) for v in low[::-1]])
        end = np.array([math.floor(v / edge) + 1 for v in high[::-1]])
        n, rows, cols = self._tables.shape
        if rows:
            first = np.minimum(first, self._corner)
            end = np.maximum(end, self._corner + np.array((rows, cols)))
            if (end - first == (rows, cols)).all():
                return
        new = np.full((n, *(end - first)), ABSENT, np.int32)
        r, c = self._corner - first if rows else (0, 0)
        new[:, r : r + rows, c : c + cols] = self._tables
        self._tables, self._corner = new, first.astype(np.int64)


def _resize(old: HitPatches | None, size: int) -> HitPatches:
    """Return `size` patches; the first are the old ones."""
    cells = PATCH * PATCH
    new = HitPatches(
        np.empty((size, cells), np.int32),
        np.empty((size, cells, 2), np.float32),
        np.zeros(size, np.int32),
        np.empty(size + 1, np.int32),
    )
    if old is not None:
        for source, target in zip(old[:-1], new[:-1], strict=True):
            target[: len(source)] = source
    _list_free(new)
    return new


def _list_free(patches: HitPatches) -> None:
    """List the free patches; the lowest is taken first."""
    unowned = np.flatnonzero(patches.owners == 0)[::-1]
    patches.free[0] = len(unowned)
    patches.free[1 : 1 + len(unowned)] = unowned


@njit(cache=True, inline="always")
def cell_of(x: float, delta: float) -> int:
    """Return a coordinate's cell: the nearest center, halves away from 0 as in C's `round`."""
    q = x / delta
    return math.floor(q + 0.5) if q >= 0 else -math.floor(0.5 - q)


@njit(cache=True, nogil=True)
def _register(tables: Any, corner: Any, patches: Any, delta: float, poses: Any, ends: Any, first: int) -> int:
    """Add a scan to the maps from `first` on; return the number done when patches run out."""
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
