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

from lirs_wct.arrays import ByteArray, FloatArray, Int32Array, IntArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from slam_baselines.gmapping.patches import (
    ABSENT,
    BITS,
    MASK,
    MEAN_MEMORY,
    MEAN_STEPS,
    PATCH,
    Patches,
    list_free,
    own_patch,
    own_record,
    records_needed,
    reserved,
    resized,
)
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
        self.patches = resized(None, 256, 64)
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
        list_free(self.patches)

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
            records = records_needed(self.tables[done], self.patches, len(scan.hits))
            self.patches = reserved(self.patches, needed, records)
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
        known = p.log_odds != UNKNOWN
        hit = np.flatnonzero(p.record != ABSENT)
        known[hit] &= ~((p.log_odds[hit] > 0) & (p.min_slope[p.record[hit]] < wall_slope))
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


@njit(cache=True, nogil=True)
def enter_scans(
    maps: Any, poses: Any, scan: Any, min_slopes: Any, wall_slope: int, steps: Any, limits: Any, first: int
) -> int:
    """Draw the scan into the maps from the first on; return how many are done when patches run out."""
    origin, hits, free = scan
    res, side = maps.resolution, limits.side
    touched = np.empty((side, side), np.uint8)
    for k in range(first, len(poses)):
        records = records_needed(maps.tables[k], maps.patches, len(hits))
        if maps.patches.free[0] < limits.patches or maps.patches.free_records[0] < records:
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


@njit(cache=True, nogil=True)
def _hit(view: Any, scratch: Any, end: Any, min_slope: int, steps: Any) -> None:
    """Raise the cell where a beam ends (u, v in cells), once a scan, and move its mean."""
    table, corner, patches, _, _ = view
    touched, window = scratch
    u, v, z = end
    row, col = int(np.floor(v)), int(np.floor(u))
    r, c = (row >> BITS) - corner[0], (col >> BITS) - corner[1]
    p = table[r, c]
    if p == ABSENT or patches.owners[p] != 1:
        p = own_patch(table, patches, r, c)
    cell = ((row & MASK) << BITS) | (col & MASK)
    q = own_record(patches, p)
    first = patches.hits[q, cell] == 0
    n = min(patches.hits[q, cell] + 1, MEAN_MEMORY)
    patches.hits[q, cell] = n
    for axis, part in ((0, u - col), (1, v - row)):
        before = patches.mean[q, cell, axis]
        patches.mean[q, cell, axis] = np.uint16(
            before + (min(part * MEAN_STEPS, MEAN_STEPS - 1.0) - before) / n
        )
    patches.min_slope[q, cell] = max(patches.min_slope[q, cell], min_slope)
    top = np.int16(z / TOP_STEP)
    patches.top[q, cell] = top if first else max(patches.top[q, cell], top)
    if touched[row - window[0], col - window[1]] == 0:
        touched[row - window[0], col - window[1]] = 1
        before = patches.log_odds[p, cell]
        patches.log_odds[p, cell] = min(steps[2], (0 if before == UNKNOWN else before) + steps[1])


@njit(cache=True, nogil=True)
def _pass(view: Any, scratch: Any, start: Any, end: Any, to_end: bool, steps: Any) -> None:
    """Lower the cells between the laser and the end of one beam (u, v in cells), each once a scan.

    A beam that passes above where a wall was hit says nothing about the wall.
    """
    table, corner, patches, _, wall_slope = view
    touched, window = scratch
    u, v, z = end
    log_odds, min_slopes, tops, owners = patches.log_odds, patches.min_slope, patches.top, patches.owners
    records = patches.record
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
            p = own_patch(table, patches, r, c)
        cell = ((row & MASK) << BITS) | (col & MASK)
        before = log_odds[p, cell]
        if before > 0 and wall_slope > 0:
            q = records[p]
            above = (z0 + i * dz) / TOP_STEP > tops[q, cell] + 10
            if above and wall_slope <= min_slopes[q, cell]:
                continue
        log_odds[p, cell] = max(-most, (0 if before == UNKNOWN else before) + miss)


@njit(cache=True, nogil=True)
def look_up(view: Any, points: Any, out: Any) -> None:
    """Read the layer `min_slope` of one map at points; 0 where nothing was drawn."""
    table, corner, patches, res, _ = view
    rows, cols = table.shape
    for i in range(len(points)):
        row, col = int(np.floor(points[i, 1] / res)), int(np.floor(points[i, 0] / res))
        r, c = (row >> BITS) - corner[0], (col >> BITS) - corner[1]
        if 0 <= r < rows and 0 <= c < cols and table[r, c] != ABSENT:
            record = patches.record[table[r, c]]
            if record != ABSENT:
                out[i] = patches.min_slope[record, ((row & MASK) << BITS) | (col & MASK)]
