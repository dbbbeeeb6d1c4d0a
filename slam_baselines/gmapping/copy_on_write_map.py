"""Copy-on-write occupancy maps of many particles in shared patches."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.geometry import ByteArray, FloatArray, Int32Array, IntArray, OccupancyGrid, njit
from slam_baselines.gmapping.patches import (
    ABSENT,
    BITS,
    CELLS,
    MASK,
    MEAN_MEMORY,
    MEAN_STEPS,
    PATCH,
    Patches,
    PatchTables,
    Window,
    new_record,
    own_patch,
    reserve_patches,
    resize,
    space_needed,
)
from slam_baselines.leveling import ScanPoints
from slam_baselines.occupancy_map import STEP, STEPS_ABOVE, TOP_STEP, UNKNOWN, UpdateConfig

NEW, PASSED, WALL, DONE = 0, 1, 2, 4
"""Marks of a cell: not met yet; met by a beam; a wall not met yet; hit, or a wall with a beam above it.

Bits: a beam adds PASSED whatever the mark, and a cell that bears no other is lowered.
"""


class Scratch(NamedTuple):
    """Marks of a scan on the cells of a window; all zeros before and after.

    Attributes:
        marks: (places, 256) uint8, NEW, PASSED, WALL or DONE.
        marked: (places,) uint8, whether a place has other marks than NEW.
        line: (n,) int32, scratch for the cells that one beam meets, numbered as in `marks`.
    """

    marks: ByteArray
    marked: ByteArray
    line: Int32Array

    @staticmethod
    def of(places: int, side: int) -> Scratch:
        """Return a scratch for windows of a number of places, `side` along the longer side."""
        line = np.empty((side + 1) * PATCH, np.int32)
        return Scratch(np.zeros((places, CELLS), np.uint8), np.zeros(places, np.uint8), line)

    def enough(self, window: Window) -> Scratch:
        """Return a scratch for a window: this one if it is large enough."""
        places, side = window.rows * window.cols, max(window.rows, window.cols)
        if len(self.marked) >= places and len(self.line) >= (side + 1) * PATCH:
            return self
        return Scratch.of(places, side)


class ParticleWindow(NamedTuple):
    """Window in one particle's map: a part of its table (rows, cols), all patches.

    The corner is row and column of its first patch in the lattice of patches. The base is x and y in cells,
    cosine and sine of its yaw in cells a meter.
    """

    table: Any
    patches: Any
    corner: Any
    base: Any


@njit
def enter_scans(
    maps: Any, window: Any, poses: Any, scan: Any, min_slopes: Any, wall_slope: int, steps: Any,
    scratch: Any, first: int,
) -> Any:  # fmt: skip
    """Enter a scan into the maps from `first` on, until patches run out.

    Returns how many maps are done, and the patches and records that the next one may take.
    """
    origin, hits, free = scan
    res, patches = maps.resolution, maps.patches
    row0, col0, rows, cols = window
    for k in range(first, len(poses)):
        table = maps.tables[k, row0 : row0 + rows, col0 : col0 + cols]
        needed, records = space_needed(table, patches, len(hits))
        if patches.free[0] < needed or patches.free_records[0] < records:
            return k, needed, records
        c, s = np.cos(poses[k, 2]) / res, np.sin(poses[k, 2]) / res
        base = poses[k, 0] / res, poses[k, 1] / res, c, s
        site = ParticleWindow(table, patches, (maps.corner[0] + row0, maps.corner[1] + col0), base)
        _raise_hits(site, scratch, hits, min_slopes, steps)
        if wall_slope > 0:
            _mark_walls(site, scratch, wall_slope)
        _mark_passed(site, scratch, origin, hits, np.int64(2))
        _mark_passed(site, scratch, origin, free, np.int64(0))
        _lower(site, scratch, steps)
    return len(poses), 0, 0


# Each kernel takes a map's beams all at once: to hand tuples of arrays on costs more than a beam.
@njit
def _raise_hits(site: Any, scratch: Any, hits: Any, min_slopes: Any, steps: Any) -> None:
    """Raise the cells where beams end, each once a scan, and move their means."""
    table, patches, (top, left), (x, y, c, s) = site
    marks, marked, _ = scratch
    counts, mean, slopes, tops = patches.hits, patches.mean, patches.min_slope, patches.top
    for i in range(len(hits)):
        u, v = x + c * hits[i, 0] - s * hits[i, 1], y + s * hits[i, 0] + c * hits[i, 1]
        row, col = int(np.floor(v)), int(np.floor(u))
        r, q = (row >> BITS) - top, (col >> BITS) - left
        place, cell = r * table.shape[1] + q, ((row & MASK) << BITS) | (col & MASK)
        p = table[r, q]
        if p == ABSENT or patches.owners[p] != 1:
            p = own_patch(table, patches, r, q)
        q = patches.record[p]
        if q == ABSENT:
            q = new_record(patches, p)
        n = min(counts[q, cell] + 1, MEAN_MEMORY)
        height = np.int16(hits[i, 2] / TOP_STEP)
        tops[q, cell] = height if counts[q, cell] == 0 else max(tops[q, cell], height)
        slopes[q, cell] = max(slopes[q, cell], min_slopes[i])
        counts[q, cell] = n
        for axis, part in ((0, u - col), (1, v - row)):
            before = mean[q, cell, axis]
            mean[q, cell, axis] = np.uint16(before + (min(part * MEAN_STEPS, MEAN_STEPS - 1.0) - before) / n)
        if marks[place, cell] == NEW:
            marks[place, cell], marked[place] = DONE, 1
            log_odds = patches.log_odds[p, cell]
            patches.log_odds[p, cell] = min(steps[2], (0 if log_odds == UNKNOWN else log_odds) + steps[1])


@njit
def _mark_walls(site: Any, scratch: Any, wall_slope: int) -> None:
    """Mark the walls of a map that the scan has not hit."""
    table, patches, _, _ = site
    rows, cols = table.shape
    least = np.int16(wall_slope)
    for r in range(rows):
        for c in range(cols):
            p = table[r, c]
            if p == ABSENT or patches.record[p] == ABSENT:
                continue
            log_odds, min_slope = patches.log_odds[p], patches.min_slope[patches.record[p]]
            mark = scratch.marks[r * cols + c]
            scratch.marked[r * cols + c] = 1
            for cell in range(CELLS):
                wall = (log_odds[cell] > 0) & (np.int16(min_slope[cell]) >= least)
                mark[cell] = WALL if wall & (mark[cell] == NEW) else mark[cell]


@njit
def _mark_passed(site: Any, scratch: Any, origin: Any, ends: Any, spared: int) -> None:
    """Mark the cells along the beams as passed, except the last steps.

    Two spared steps spare the cell in which a beam ends, since they are as long as it at least.
    """
    table, patches, (top, left), (x, y, c, s) = site
    marked, line, cols = scratch.marked, scratch.line, table.shape[1]
    marks = scratch.marks.ravel()
    x0, y0, z0 = x + c * origin[0] - s * origin[1], y + s * origin[0] + c * origin[1], origin[2]
    for i in range(len(ends)):
        u, v = x + c * ends[i, 0] - s * ends[i, 1], y + s * ends[i, 0] + c * ends[i, 1]
        n = int(max(abs(u - x0), abs(v - y0))) + 1
        count = n + 1 - spared
        _number_cells(line, count, (x0, y0, (u - x0) / n, (v - y0) / n), top << BITS, left << BITS, cols)
        met = np.uint8(NEW)
        for k in range(count):
            at = np.uintp(line[k])
            mark = marks[at]
            met |= mark
            marks[at] = mark | np.uint8(PASSED)
            marked[at >> np.uintp(2 * BITS)] = 1
        if met & WALL:
            rise = z0, (ends[i, 2] - z0) / n
            _pass_walls(table, patches.record, patches.top, marks, line[:count], rise)


@njit
def _pass_walls(table: Any, record: Any, top: Any, marks: Any, line: Any, rise: Any) -> None:
    """Mark the walls that a beam meets first: passed, or done if it passes above."""
    z, dz = rise
    for k in range(len(line)):
        if marks[line[k]] & WALL:
            place, cell = line[k] // CELLS, line[k] % CELLS
            highest = top[record[table[place // table.shape[1], place % table.shape[1]]], cell]
            marks[line[k]] = DONE if (z + k * dz) / TOP_STEP > highest + STEPS_ABOVE else PASSED


@njit
def _number_cells(line: Any, count: int, ray: Any, row0: int, col0: int, cols: int) -> None:
    """Fill the first numbers of `line` with a beam's cells, without branches for SIMD."""
    x, y, du, dv = ray
    south, west, across = np.int32(row0), np.int32(col0), np.int32(cols)
    for i in range(count):
        row = np.int32(np.int32(np.floor(y + i * dv)) - south)
        col = np.int32(np.int32(np.floor(x + i * du)) - west)
        place = np.int32(np.int32(np.int32(row >> BITS) * across) + np.int32(col >> BITS))
        inside = np.int32(np.int32((row & MASK) << BITS) | np.int32(col & MASK))
        line[i] = np.int32(np.int32(place << 2 * BITS) | inside)


@njit
def _lower(site: Any, scratch: Any, steps: Any) -> None:
    """Lower the passed cells, and clear the marks."""
    table, patches, _, _ = site
    cols = table.shape[1]
    miss, least = np.int16(steps[0]), np.int16(-steps[2])
    for place in range(table.size):
        if scratch.marked[place] == 0:
            continue
        scratch.marked[place] = 0
        mark = scratch.marks[place]
        passed = False
        for cell in range(CELLS):
            passed |= mark[cell] == PASSED
        if passed:
            r, c = place // cols, place % cols
            p = table[r, c]
            if p == ABSENT or patches.owners[p] != 1:
                p = own_patch(table, patches, r, c)
            log_odds = patches.log_odds[p]
            for cell in range(CELLS):
                before = np.int16(log_odds[cell])
                after = np.int16((np.int16(0) if before == UNKNOWN else before) + miss)
                after = max(after, least)
                log_odds[cell] = np.int8(after if mark[cell] == PASSED else before)
        mark[:] = NEW


class PatchMaps(PatchTables[Patches]):
    """Occupancy maps of a set of particles."""

    def __init__(self, particles: int, resolution: float) -> None:
        super().__init__(particles, resolution, resize(None, 256, 64))
        self._scratch = Scratch.of(0, 0)
        self._steps = UpdateConfig().steps

    def draw_scan(self, poses: FloatArray, scan: ScanPoints, min_slopes: ByteArray, wall_slope: int) -> None:
        """Draw one scan into every map, each from its own pose (particles, 3) of `T_map_base`.

        The scan's x and y are in the leveled base frame, its heights in the map frame. It has (n,) minimum
        slopes; hits from `wall_slope` on, SLOPE_STEP, are walls.
        """
        ends = np.concatenate((scan.hits, scan.free, scan.origin[None]))[:, :2]
        reach = float(np.sqrt((ends**2).sum(axis=1).max())) + 2 * self.resolution
        window = self.cover(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
        self._scratch, done = self._scratch.enough(window), 0
        while True:
            done, needed, records = enter_scans(
                self.stack, window, poses, scan, min_slopes, wall_slope, self._steps, self._scratch, done
            )
            if done == len(poses):
                return
            self.patches = reserve_patches(self.patches, needed, records)

    @property
    def stack(self) -> MapStack:
        """All maps for the kernels; void after the next change."""
        return MapStack(self.tables, self.corner, self.patches, self.resolution)

    def view(self, particle: int, wall_slope: int) -> PatchMapView:
        """Return one map for the kernels; void after the next change."""
        return PatchMapView(self.tables[particle], self.corner, self.patches, self.resolution, wall_slope)

    def min_slope(self, particle: int, points: FloatArray) -> ByteArray:
        """Return (n,) minimum slopes of the map's cells at points (n, 2 or more)."""
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
        row0, col0 = (self.corner * PATCH).tolist()
        return OccupancyGrid.of_lattice(grid, self.resolution, row0, col0)


class PatchMapView(NamedTuple):
    """One particle's map for the kernels: its table (rows, cols), and the corner of PatchTables.

    Hits of at least the minimum slope `wall_slope`, SLOPE_STEP, are walls.
    """

    table: Int32Array
    corner: IntArray
    patches: Patches
    resolution: float
    wall_slope: int


class MapStack(NamedTuple):
    """All maps for the kernels; attributes as of PatchMaps."""

    tables: Int32Array
    corner: IntArray
    patches: Patches
    resolution: float


@njit
def look_up(view: Any, points: Any, out: Any) -> None:
    """Fill `out` with the layer `min_slope` of one map at points; 0 in empty cells."""
    table, corner, patches, res, _ = view
    rows, cols = table.shape
    for i in range(len(points)):
        row, col = int(np.floor(points[i, 1] / res)), int(np.floor(points[i, 0] / res))
        r, c = (row >> BITS) - corner[0], (col >> BITS) - corner[1]
        if 0 <= r < rows and 0 <= c < cols and table[r, c] != ABSENT:
            record = patches.record[table[r, c]]
            if record != ABSENT:
                out[i] = patches.min_slope[record, ((row & MASK) << BITS) | (col & MASK)]
