"""Patches of 16 x 16 map cells, shared by the particles, with separate hit records.

Most of a particle's map was drawn before it split from its siblings and is the same as theirs. So a map is
a table of patches; children get their parent's table, and a patch that several tables point at is copied by
the first that draws into it. Memory grows with the differences.

Most patches are free space, which needs a byte a cell. Where beams ended, eight more: these are kept for
patches with a hit alone, so that a laser that sees far over open ground costs little.
"""

from __future__ import annotations

import math
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, ByteArray, FloatArray, Int32Array, IntArray, njit
from slam_baselines.occupancy_map import UNKNOWN

BITS = 4
PATCH = 1 << BITS
"""Cells along the edge of a patch."""
MASK = PATCH - 1
CELLS = PATCH * PATCH
ABSENT = -1
"""Marks, in a table, a patch that nothing was drawn into; in `record`, a patch without hits."""
MEAN_STEPS = 65536
"""Steps of a cell's edge in which the mean of the hits in it is kept."""
MEAN_MEMORY = 32
"""Number of the latest hits in the mean."""


class Patches(NamedTuple):
    """All patches of all maps for the kernels, one row each, cells in row order.

    Attributes:
        log_odds: (p, 256) int8, steps of STEP, UNKNOWN where no beam came.
        record: (p,) int32, the record of its hits; ABSENT where none of its cells was hit.
        owners: (p,) int32, tables that point at the patch; 0 = free.
        free: (1 + p,) int32, how many patches are free, and then which.
        hits: (r, 256) uint8, how many beams ended there, up to MEAN_MEMORY.
        mean: (r, 256, 2) uint16, where they ended on average, MEAN_STEPS east and north of the cell's corner.
        min_slope: (r, 256) uint8, largest minimum slope of the hits there, SLOPE_STEP.
        top: (r, 256) int16, largest height at which it was hit, TOP_STEP.
        free_records: (1 + r,) int32, how many records are free, and then which.
    """

    log_odds: NDArray[np.int8]
    record: Int32Array
    owners: Int32Array
    free: Int32Array
    hits: ByteArray
    mean: NDArray[np.uint16]
    min_slope: ByteArray
    top: NDArray[np.int16]
    free_records: Int32Array

    def list_free(self) -> None:
        """List the free patches and records; the lowest is taken first."""
        owned = self.owners > 0
        self.record[~owned] = ABSENT
        recorded = np.zeros(len(self.hits), np.bool_)
        recorded[self.record[self.record != ABSENT]] = True
        list_rows(self.free, owned)
        list_rows(self.free_records, recorded)


Kind = TypeVar("Kind", bound=Any)


def list_rows(free: Int32Array, taken: BoolArray) -> None:
    """Fill `free` with the number of free rows and their indices, the highest first."""
    left = np.flatnonzero(~taken)[::-1]
    free[0] = len(left)
    free[1 : 1 + len(left)] = left


class Window(NamedTuple):
    """Window of the tables that a scan can reach: first row and column, rows, columns."""

    row: int
    col: int
    rows: int
    cols: int


class PatchTables(Generic[Kind]):
    """Maps of particles over one growing lattice of cells of an edge `resolution`, meters.

    Attributes:
        tables: (particles, rows, cols) int32, the patch at each place of each map.
        corner: (2,) int64, row and column of the tables' first patch in the lattice of patches.
        patches: Targets of the tables.
    """

    def __init__(self, particles: int, resolution: float, patches: Kind) -> None:
        self.resolution = resolution
        self.tables: Int32Array = np.empty((particles, 0, 0), np.int32)
        self.corner: IntArray = np.zeros(2, np.int64)
        self.patches: Kind = patches

    @property
    def nbytes(self) -> int:
        """Memory of patches and tables."""
        return int(self.tables.nbytes + sum(array.nbytes for array in self.patches))

    @property
    def in_use(self) -> int:
        """Patches that at least one map points at."""
        return len(self.patches.owners) - int(self.patches.free[0])

    def descend(self, parents: IntArray) -> None:
        """Replace map i by a copy of the former map `parents[i]`; copies share their patches."""
        self.tables = self.tables[parents]
        owners = np.bincount(self.tables[self.tables != ABSENT], minlength=len(self.patches.owners))
        self.patches.owners[:] = owners
        self.patches.list_free()

    def cover(self, low: FloatArray, high: FloatArray) -> Window:
        """Extend the tables by the box (x, y in meters); return its window."""
        edge = PATCH * self.resolution
        south, west = (math.floor(v / edge) for v in low[::-1])
        north, east = (math.floor(v / edge) + 1 for v in high[::-1])
        first: IntArray = np.array((south, west))
        end: IntArray = np.array((north, east))
        n, rows, cols = self.tables.shape
        if rows:
            first, end = np.minimum(first, self.corner), np.maximum(end, self.corner + np.array((rows, cols)))
        if not rows or (end - first != (rows, cols)).any():
            new = np.full((n, *(end - first)), ABSENT, np.int32)
            r, c = self.corner - first if rows else (0, 0)
            new[:, r : r + rows, c : c + cols] = self.tables
            self.tables, self.corner = new, first
        return Window(south - int(self.corner[0]), west - int(self.corner[1]), north - south, east - west)


def resize(old: Patches | None, patches: int, records: int) -> Patches:
    """Return patches and records of the given numbers; the first are the old ones."""
    new = Patches(
        np.empty((patches, CELLS), np.int8),
        np.full(patches, ABSENT, np.int32),
        np.zeros(patches, np.int32),
        np.empty(patches + 1, np.int32),
        np.empty((records, CELLS), np.uint8),
        np.empty((records, CELLS, 2), np.uint16),
        np.empty((records, CELLS), np.uint8),
        np.empty((records, CELLS), np.int16),
        np.empty(records + 1, np.int32),
    )
    if old is not None:
        # Rows that were never taken are not copied: they would become memory.
        patches = int(np.flatnonzero(old.owners).max(initial=-1)) + 1
        records = int(old.record.max(initial=ABSENT)) + 1
        for name in ("log_odds", "record", "owners"):
            getattr(new, name)[:patches] = getattr(old, name)[:patches]
        for name in ("hits", "mean", "min_slope", "top"):
            getattr(new, name)[:records] = getattr(old, name)[:records]
    new.list_free()
    return new


def reserve_patches(patches: Patches, needed: int, records: int) -> Patches:
    """Return patches with enough free patches and records; the same ones if possible."""
    more = [
        0 if int(free[0]) >= wanted else max(wanted - int(free[0]), len(free) - 1)
        for free, wanted in ((patches.free, needed), (patches.free_records, records))
    ]
    if more == [0, 0]:
        return patches
    return resize(patches, len(patches.owners) + more[0], len(patches.hits) + more[1])


@njit
def space_needed(table: Any, patches: Any, hits: int) -> Any:
    """Return upper bounds of the patches and records that a scan within a table takes."""
    new = shared = 0
    for r in range(table.shape[0]):
        for c in range(table.shape[1]):
            p = table[r, c]
            if p == ABSENT:
                new += 1
            elif patches.owners[p] > 1:
                new += 1
                shared += patches.record[p] != ABSENT
    return new, shared + hits


@njit
def own_patch(table: Any, patches: Any, row: int, col: int) -> Any:
    """Give a table its own patch, new or copied, at a place; return its index."""
    p = table[row, col]
    patches.free[0] -= 1
    q = patches.free[1 + patches.free[0]]
    patches.record[q] = ABSENT
    if p == ABSENT:
        patches.log_odds[q] = UNKNOWN
    else:
        patches.owners[p] -= 1
        _copy_row(patches.log_odds, p, q)
        source = patches.record[p]
        if source != ABSENT:
            target = _free_record(patches)
            patches.record[q] = target
            _copy_row(patches.hits, source, target)
            _copy_row(patches.min_slope, source, target)
            _copy_row(patches.top, source, target)
            for k in range(CELLS):
                patches.mean[target, k, 0] = patches.mean[source, k, 0]
                patches.mean[target, k, 1] = patches.mean[source, k, 1]
    patches.owners[q] = 1
    table[row, col] = q
    return q


@njit
def _copy_row(rows: Any, source: int, target: int) -> None:
    # Cell by cell: of assigned rows Numba would compile the message of shapes that differ.
    for k in range(CELLS):
        rows[target, k] = rows[source, k]


@njit
def new_record(patches: Any, p: int) -> Any:
    """Give a patch its first record, without a hit; return its index."""
    r = _free_record(patches)
    patches.hits[r] = 0
    patches.min_slope[r] = 0
    patches.record[p] = r
    return r


@njit
def _free_record(patches: Any) -> Any:
    patches.free_records[0] -= 1
    return patches.free_records[1 + patches.free_records[0]]
