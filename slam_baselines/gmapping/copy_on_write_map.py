"""Maps of many particles in patches that are shared until one of them writes: copy on write.

Most of a particle's map was drawn before it split from its siblings and is the same as theirs. A map is
a table of patches of 16 x 16 cells; children get their parent's table, and a patch that several tables
point at is copied by the first that draws into it. So memory goes with what differs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_wct.arrays import ByteArray, FloatArray, Int32Array, IntArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from slam_baselines.mapping.occupancy_map import STEP, TOP_STEP, UNKNOWN, UpdateConfig
from slam_baselines.scan.leveling import ScanPoints


class PatchMaps:
    """The occupancy maps of a set of particles, over one lattice of cells that grows where needed.

    Attributes:
        resolution: edge of a cell, metres.
        tables: (particles, rows, cols) int32, the patch at each place of each map.
        corner: (2,) int64, row and column of the tables' first patch in the lattice of patches.
        patches: what the tables point at.
    """

    def __init__(self, particles: int, resolution: float, update: UpdateConfig | None = None) -> None:
        self.resolution = resolution
        self.tables: Int32Array = np.empty((particles, 0, 0), np.int32)
        self.corner: IntArray = np.zeros(2, np.int64)
        self.patches = _resized(None, 256)
        self._steps = (update or UpdateConfig()).steps

    @property
    def nbytes(self) -> int:
        """Memory of patches and tables."""
        return self.tables.nbytes + sum(a.nbytes for a in self.patches)

    @property
    def in_use(self) -> int:
        """Patches that at least one map points at."""
        return len(self.patches.owners) - int(self.patches.free[0])

    def descend(self, parents: IntArray) -> None:
        """Let map i become a copy of what map `parents[i]` was; copies share their patches."""
        self.tables = self.tables[parents]
        owners = np.bincount(self.tables[self.tables != ABSENT].ravel(), minlength=len(self.patches.owners))
        self.patches.owners[:] = owners
        _list_free(self.patches)

    def draw_scan(self, poses: FloatArray, scan: ScanPoints, min_slopes: ByteArray, wall_slope: int) -> None:
        """Draw one scan into every map, each from its own pose.

        Args:
            poses: (particles, 3) x, y, yaw of `T_map_base`.
            scan: x and y in the leveled base frame, heights in the map frame.
            min_slopes: (n,) of each hit, SLOPE_STEP.
            wall_slope: minimum slope from which on a cell is a wall, SLOPE_STEP.
        """
        ends = np.concatenate((scan.hits, scan.free, scan.origin[None]))[:, :2]
        reach = float(np.sqrt((ends**2).sum(axis=1).max())) + 2 * self.resolution
        self._cover(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
        span = 2 * reach / self.resolution
        # A beam crosses at most two new patches each patch length, in either direction.
        needed = int(min((span / PATCH + 2) ** 2, (len(ends) + 1) * (span / PATCH + 3)))
        done = 0
        while done < len(poses):
            self._reserve(needed)
            limits = EntryLimits(int(span) + 4, needed)
            done = enter_scans(
                self.stack, poses, scan, min_slopes, wall_slope, np.array(self._steps), limits, done
            )

    @property
    def stack(self) -> MapStack:
        """All maps for the kernels; void after the next change."""
        return MapStack(self.tables, self.corner, self.patches, self.resolution)

    def view(self, particle: int, wall_slope: int) -> MapView:
        """Return one map for the kernels; void after the next change."""
        return MapView(self.tables[particle], self.corner, self.patches, self.resolution, wall_slope)

    def min_slope(self, particle: int, points: FloatArray) -> ByteArray:
        """Return (n,) the minimum slopes of the cells under points (n, 2 or more) of the map frame."""
        out = np.zeros(len(points), np.uint8)
        look_up(self.view(particle, 0), points, out)
        return out

    def occupancy_grid(self, particle: int, wall_slope: int) -> OccupancyGrid:
        """Return one map; hits whose minimum slope is below `wall_slope` are unknown, not occupied."""
        table, p = self.tables[particle], self.patches
        rows, cols = table.shape
        lattice = table.ravel()
        known = (p.log_odds != UNKNOWN) & ~((p.log_odds > 0) & (p.min_slope < wall_slope))
        values = np.where(known, p.log_odds * np.float32(STEP), np.float32(np.nan)).astype(np.float32)
        values = np.where((lattice == ABSENT)[:, None], np.float32(np.nan), values[lattice])
        grid = values.reshape(rows, cols, PATCH, PATCH).swapaxes(1, 2).reshape(rows * PATCH, cols * PATCH)
        r, c = (np.flatnonzero(~np.isnan(grid).all(axis=axis)) for axis in (1, 0))
        if len(r) == 0:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), self.resolution)
        row0, col0 = self.corner * PATCH + (r[0], c[0])
        corner = Pose2(float(col0 * self.resolution), float(row0 * self.resolution))
        return OccupancyGrid(grid[r[0] : r[-1] + 1, c[0] : c[-1] + 1].copy(), self.resolution, corner)

    def _cover(self, low: FloatArray, high: FloatArray) -> None:
        """Make the box (x, y in metres) part of the tables."""
        edge = PATCH * self.resolution
        first = np.array([math.floor(v / edge) for v in low[::-1]])
        end = np.array([math.floor(v / edge) + 1 for v in high[::-1]])
        n, rows, cols = self.tables.shape
        if rows:
            first, end = np.minimum(first, self.corner), np.maximum(end, self.corner + np.array((rows, cols)))
            if (end - first == (rows, cols)).all():
                return
        new = np.full((n, *(end - first)), ABSENT, np.int32)
        r, c = self.corner - first if rows else (0, 0)
        new[:, r : r + rows, c : c + cols] = self.tables
        self.tables, self.corner = new, first.astype(np.int64)

    def _reserve(self, needed: int) -> None:
        """Have so many patches free."""
        free = int(self.patches.free[0])
        if free < needed:
            size = len(self.patches.owners)
            self.patches = _resized(self.patches, max(size + needed - free, size + size // 4))


def _resized(old: Patches | None, size: int) -> Patches:
    """Return `size` patches of which the first are the old ones."""
    shape = size, PATCH * PATCH
    new = Patches(
        np.empty(shape, np.int8),
        np.empty(shape, np.uint8),
        np.empty((*shape, 2), np.uint16),
        np.empty(shape, np.uint8),
        np.empty(shape, np.int16),
        np.zeros(size, np.int32),
        np.empty(size + 1, np.int32),
    )
    if old is not None:
        for source, target in zip(old[:-1], new[:-1], strict=True):
            target[: len(source)] = source  # type: ignore[arg-type, index]
    _list_free(new)
    return new


def _list_free(patches: Patches) -> None:
    """Note which patches nobody owns, the lowest to be taken first."""
    unowned = np.flatnonzero(patches.owners == 0)[::-1]
    patches.free[0] = len(unowned)
    patches.free[1 : 1 + len(unowned)] = unowned


BITS = 4
PATCH = 1 << BITS
"""Cells along the edge of a patch."""
MASK = PATCH - 1
ABSENT = -1
"""Marks, in a table, a patch that nothing was drawn into."""
MEAN_STEPS = 65536
"""Steps of a cell's edge in which the mean of the hits in it is kept."""
MEAN_MEMORY = 32
"""The mean follows the last so many hits."""


class Patches(NamedTuple):
    """All patches of all maps, one row each, cells in row order; as the kernels need them.

    Attributes:
        log_odds: (p, 256) int8, steps of STEP, UNKNOWN where no beam came.
        hits: (p, 256) uint8, how many beams ended there, up to MEAN_MEMORY.
        mean: (p, 256, 2) uint16, where they ended on average, MEAN_STEPS east and north of the cell's corner.
        min_slope: (p, 256) uint8, largest minimum slope of what was hit there, SLOPE_STEP.
        top: (p, 256) int16, largest height at which it was hit, TOP_STEP.
        owners: (p,) int32, tables that point at the patch; 0 = free.
        free: (1 + p,) int32, how many patches are free, and then which.
    """

    log_odds: NDArray[np.int8]
    hits: ByteArray
    mean: NDArray[np.uint16]
    min_slope: ByteArray
    top: NDArray[np.int16]
    owners: Int32Array
    free: Int32Array


class MapView(NamedTuple):
    """One particle's map as the kernels see it.

    Attributes:
        table: (rows, cols) int32, the patch at each place.
        corner: (2,) row and column of the table's first patch.
        patches: all patches.
        resolution: edge of a cell, metres.
        wall_slope: minimum slope from which on a hit is a wall, SLOPE_STEP.
    """

    table: Int32Array
    corner: IntArray
    patches: Patches
    resolution: float
    wall_slope: int


class MapStack(NamedTuple):
    """All maps as the kernels see them; attributes as of PatchMaps."""

    tables: Int32Array
    corner: IntArray
    patches: Patches
    resolution: float


class EntryLimits(NamedTuple):
    """Cells along the edge of the window that a scan reaches, and patches that it may need."""

    side: int
    patches: int


class Scratch(NamedTuple):
    """Cells that a scan has touched: (side, side) flags, and the lattice row and column of their first."""

    touched: ByteArray
    window: IntArray


@njit(cache=True)
def _own(table: Any, patches: Any, row: int, col: int) -> Any:
    """Put a patch of its own, new or copied, at a place of a table; return which."""
    p = table[row, col]
    patches.free[0] -= 1
    q = patches.free[1 + patches.free[0]]
    if p == ABSENT:
        patches.log_odds[q] = UNKNOWN
        patches.hits[q] = 0
        patches.min_slope[q] = 0
    else:
        patches.owners[p] -= 1
        patches.log_odds[q] = patches.log_odds[p]
        patches.hits[q] = patches.hits[p]
        patches.min_slope[q] = patches.min_slope[p]
        # Most patches are free space: what was never hit has neither mean nor top.
        if patches.hits[q].any():
            patches.mean[q] = patches.mean[p]
            patches.top[q] = patches.top[p]
    patches.owners[q] = 1
    table[row, col] = q
    return q


@njit(cache=True)
def enter_scans(
    maps: Any, poses: Any, scan: Any, min_slopes: Any, wall_slope: int, steps: Any, limits: Any, first: int
) -> int:
    """Draw the scan into the maps from the first on; return how many are done when patches run out."""
    origin, hits, free = scan
    res, side = maps.resolution, limits.side
    touched = np.empty((side, side), np.uint8)
    for k in range(first, len(poses)):
        if maps.patches.free[0] < limits.patches:
            return k
        touched[:] = 0
        x, y = poses[k, 0] / res, poses[k, 1] / res
        c, s = np.cos(poses[k, 2]) / res, np.sin(poses[k, 2]) / res
        start = np.array((x + c * origin[0] - s * origin[1], y + s * origin[0] + c * origin[1], origin[2]))
        window = np.array((int(np.floor(y)) - side // 2, int(np.floor(x)) - side // 2))
        view = MapView(maps.tables[k], maps.corner, maps.patches, res, wall_slope)
        scratch = Scratch(touched, window)
        for i in range(len(hits)):
            u, v = x + c * hits[i, 0] - s * hits[i, 1], y + s * hits[i, 0] + c * hits[i, 1]
            _hit(view, scratch, (u, v, hits[i, 2]), min_slopes[i], steps)
        for i in range(len(hits) + len(free)):
            to_end = i >= len(hits)
            end = free[i - len(hits)] if to_end else hits[i]
            u, v = x + c * end[0] - s * end[1], y + s * end[0] + c * end[1]
            _pass(view, scratch, start, (u, v, end[2]), to_end, steps)
    return len(poses)


@njit(cache=True)
def _hit(view: Any, scratch: Any, end: Any, min_slope: int, steps: Any) -> None:
    """Raise the cell where a beam ends (u, v in cells), once a scan, and move its mean."""
    table, corner, patches, _, _ = view
    touched, window = scratch
    u, v, z = end
    row, col = int(np.floor(v)), int(np.floor(u))
    r, c = (row >> BITS) - corner[0], (col >> BITS) - corner[1]
    p = table[r, c]
    if p == ABSENT or patches.owners[p] != 1:
        p = _own(table, patches, r, c)
    cell = ((row & MASK) << BITS) | (col & MASK)
    first = patches.hits[p, cell] == 0
    n = min(patches.hits[p, cell] + 1, MEAN_MEMORY)
    patches.hits[p, cell] = n
    for axis, part in ((0, u - col), (1, v - row)):
        before = patches.mean[p, cell, axis]
        patches.mean[p, cell, axis] = np.uint16(
            before + (min(part * MEAN_STEPS, MEAN_STEPS - 1.0) - before) / n
        )
    patches.min_slope[p, cell] = max(patches.min_slope[p, cell], min_slope)
    top = np.int16(z / TOP_STEP)
    patches.top[p, cell] = top if first else max(patches.top[p, cell], top)
    if touched[row - window[0], col - window[1]] == 0:
        touched[row - window[0], col - window[1]] = 1
        before = patches.log_odds[p, cell]
        patches.log_odds[p, cell] = min(steps[2], (0 if before == UNKNOWN else before) + steps[1])


@njit(cache=True)
def _pass(view: Any, scratch: Any, start: Any, end: Any, to_end: bool, steps: Any) -> None:
    """Lower the cells between the laser and the end of one beam (u, v in cells), each once a scan.

    A beam that passes above where a wall was hit says nothing about the wall.
    """
    table, corner, patches, _, wall_slope = view
    touched, window = scratch
    u, v, z = end
    log_odds, min_slopes, tops, owners = patches.log_odds, patches.min_slope, patches.top, patches.owners
    top, left, row0, col0 = corner[0], corner[1], window[0], window[1]
    x0, y0, z0, miss, most = start[0], start[1], start[2], steps[0], steps[2]
    n = int(max(abs(u - start[0]), abs(v - start[1]))) + 1
    du, dv, dz = (u - start[0]) / n, (v - start[1]) / n, (z - start[2]) / n
    last_row, last_col = int(np.floor(v)), int(np.floor(u))
    for i in range(n + 1 if to_end else n - 1):
        row, col = int(np.floor(y0 + i * dv)), int(np.floor(x0 + i * du))
        if row == last_row and col == last_col and not to_end:
            break
        if touched[row - row0, col - col0]:
            continue
        touched[row - row0, col - col0] = 1
        r, c = (row >> BITS) - top, (col >> BITS) - left
        p = table[r, c]
        if p == ABSENT or owners[p] != 1:
            p = _own(table, patches, r, c)
        cell = ((row & MASK) << BITS) | (col & MASK)
        before = log_odds[p, cell]
        above = (z0 + i * dz) / TOP_STEP > tops[p, cell] + 10
        if before > 0 and 0 < wall_slope <= min_slopes[p, cell] and above:
            continue
        log_odds[p, cell] = max(-most, (0 if before == UNKNOWN else before) + miss)


@njit(cache=True)
def look_up(view: Any, points: Any, out: Any) -> None:
    """Read the layer `min_slope` of one map at points; 0 where nothing was drawn."""
    table, corner, patches, res, _ = view
    rows, cols = table.shape
    for i in range(len(points)):
        row, col = int(np.floor(points[i, 1] / res)), int(np.floor(points[i, 0] / res))
        r, c = (row >> BITS) - corner[0], (col >> BITS) - corner[1]
        if 0 <= r < rows and 0 <= c < cols and table[r, c] != ABSENT:
            out[i] = patches.min_slope[table[r, c], ((row & MASK) << BITS) | (col & MASK)]
