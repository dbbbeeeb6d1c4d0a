"""Entry of one scan into the maps of all particles: cells where beams end are raised, passed ones lowered.

Every cell changes at most once a scan, and a hit wins. So the beams only mark the cells that they meet, and
what is marked as passed is then lowered patch by patch: the beams near the laser, which all meet the same
cells, cost little, and a patch is lowered at a stroke.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import ByteArray, Int32Array
from lirs_wct.kernels import njit
from slam_baselines.gmapping.patches import (
    ABSENT,
    BITS,
    CELLS,
    MASK,
    MEAN_MEMORY,
    MEAN_STEPS,
    PATCH,
    own_patch,
    own_record,
    space_needed,
)
from slam_baselines.mapping.occupancy_map import ABOVE, TOP_STEP, UNKNOWN

NEW, PASSED, WALL, DONE = 0, 1, 2, 3
"""Marks of a cell: not met yet; to be lowered; a wall not met yet; hit, or a wall with a beam above it."""


class Window(NamedTuple):
    """Places of the tables that a scan can reach: row and column of the first, and how many each way."""

    row: int
    col: int
    rows: int
    cols: int


class Scratch(NamedTuple):
    """What a scan does to the cells of a window; all zeros before and after.

    Attributes:
        marks: (places, 256) uint8, NEW, PASSED, WALL or DONE.
        marked: (places,) uint8, whether a place has other marks than NEW.
        line: (n,) int32, room for the cells that one beam meets, numbered as in `marks`.
    """

    marks: ByteArray
    marked: ByteArray
    line: Int32Array

    @staticmethod
    def of(window: Window) -> Scratch:
        """Return a scratch for a window."""
        places = window.rows * window.cols
        line = np.empty((max(window.rows, window.cols) + 1) * PATCH, np.int32)
        return Scratch(np.zeros((places, CELLS), np.uint8), np.zeros(places, np.uint8), line)


class Site(NamedTuple):
    """The window in one particle's map: its part of the table, and its corner in the lattice of patches."""

    table: Any
    patches: Any
    top: int
    left: int


@njit(cache=True, nogil=True)
def enter_scans(
    maps: Any, window: Any, poses: Any, scan: Any, min_slopes: Any, wall_slope: int, steps: Any,
    scratch: Any, first: int,
) -> Any:  # fmt: skip
    """Enter a scan into the maps from the first on, as long as there are patches.

    Args:
        maps: MapStack.
        window: that holds the scan from every pose.
        poses: (particles, 3) x, y, yaw of `T_map_base`.
        scan: x and y in the leveled base frame, heights in the map frame.
        min_slopes: (n,) of each hit.
        wall_slope: minimum slope from which on a cell is a wall.
        steps: miss, hit and limit of the log-odds.
        scratch: of the window.
        first: map.

    Returns:
        How many maps are done, and the patches and records that the next one may take.
    """
    origin, hits, free = scan
    res, patches = maps.resolution, maps.patches
    row0, col0, rows, cols = window
    for k in range(first, len(poses)):
        table = maps.tables[k, row0 : row0 + rows, col0 : col0 + cols]
        needed, records = space_needed(table, patches, len(hits))
        if patches.free[0] < needed or patches.free_records[0] < records:
            return k, needed, records
        site = Site(table, patches, maps.corner[0] + row0, maps.corner[1] + col0)
        x, y = poses[k, 0] / res, poses[k, 1] / res
        c, s = np.cos(poses[k, 2]) / res, np.sin(poses[k, 2]) / res
        start = x + c * origin[0] - s * origin[1], y + s * origin[0] + c * origin[1], origin[2]
        for i in range(len(hits)):
            u, v = x + c * hits[i, 0] - s * hits[i, 1], y + s * hits[i, 0] + c * hits[i, 1]
            _hit(site, scratch, (u, v, hits[i, 2]), min_slopes[i], steps)
        if wall_slope > 0:
            _mark_walls(site, scratch, wall_slope)
        for i in range(len(hits) + len(free)):
            to_end = i >= len(hits)
            end = free[i - len(hits)] if to_end else hits[i]
            u, v = x + c * end[0] - s * end[1], y + s * end[0] + c * end[1]
            _pass(site, scratch, start, (u, v, end[2]), to_end)
        _lower(site, scratch, steps)
    return len(poses), 0, 0


@njit(cache=True, nogil=True)
def _hit(site: Any, scratch: Any, end: Any, min_slope: int, steps: Any) -> None:
    """Raise the cell where a beam ends (u, v in cells), once a scan, and move its mean."""
    table, patches, top, left = site
    u, v, z = end
    row, col = int(np.floor(v)), int(np.floor(u))
    r, c = (row >> BITS) - top, (col >> BITS) - left
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
    height = np.int16(z / TOP_STEP)
    patches.top[q, cell] = height if first else max(patches.top[q, cell], height)
    place = r * table.shape[1] + c
    if scratch.marks[place, cell] == NEW:
        scratch.marks[place, cell], scratch.marked[place] = DONE, 1
        log_odds = patches.log_odds[p, cell]
        patches.log_odds[p, cell] = min(steps[2], (0 if log_odds == UNKNOWN else log_odds) + steps[1])


@njit(cache=True, nogil=True)
def _mark_walls(site: Any, scratch: Any, wall_slope: int) -> None:
    """Mark the walls of a map that the scan has not hit."""
    table, patches, _, _ = site
    rows, cols = table.shape
    for r in range(rows):
        for c in range(cols):
            p = table[r, c]
            if p == ABSENT or patches.record[p] == ABSENT:
                continue
            log_odds, min_slope = patches.log_odds[p], patches.min_slope[patches.record[p]]
            mark = scratch.marks[r * cols + c]
            scratch.marked[r * cols + c] = 1
            for cell in range(CELLS):
                if log_odds[cell] > 0 and min_slope[cell] >= wall_slope and mark[cell] == NEW:
                    mark[cell] = WALL


@njit(cache=True, nogil=True)
def _pass(site: Any, scratch: Any, start: Any, end: Any, to_end: bool) -> None:
    """Mark the cells between the laser and the end of one beam (u, v in cells) as passed.

    A beam that passes above where a wall was hit says nothing about the wall.
    """
    table, patches, top, left = site
    line, cols = scratch.line, table.shape[1]
    marks, marked = scratch.marks.ravel(), scratch.marked
    x, y, z = start
    n = int(max(abs(end[0] - x), abs(end[1] - y))) + 1
    du, dv, dz = (end[0] - x) / n, (end[1] - y) / n, (end[2] - z) / n
    count = n + 1 if to_end else n - 1
    _number_cells(line, count, (x, y, du, dv), top << BITS, left << BITS, cols)
    last = -1
    if not to_end:
        row, col = int(np.floor(end[1])) - (top << BITS), int(np.floor(end[0])) - (left << BITS)
        last = ((row >> BITS) * cols + (col >> BITS)) * CELLS + ((row & MASK) << BITS) + (col & MASK)
    for i in range(count):
        at = np.uintp(line[i])
        if line[i] == last:
            break
        mark = marks[at]
        if mark < WALL:
            marks[at] = PASSED
            marked[at >> np.uintp(2 * BITS)] = 1
        elif mark == WALL:
            place, cell = line[i] // CELLS, line[i] % CELLS
            highest = patches.top[patches.record[table[place // cols, place % cols]], cell]
            marks[at] = DONE if (z + i * dz) / TOP_STEP > highest + ABOVE else PASSED


@njit(cache=True, nogil=True)
def _number_cells(line: Any, count: int, ray: Any, row0: int, col0: int, cols: int) -> None:
    """Fill the first numbers of `line` with the cells of a beam: a loop without branches, for SIMD."""
    x, y, du, dv = ray
    south, west, across = np.int32(row0), np.int32(col0), np.int32(cols)
    for i in range(count):
        row = np.int32(np.int32(np.floor(y + i * dv)) - south)
        col = np.int32(np.int32(np.floor(x + i * du)) - west)
        place = np.int32(np.int32(np.int32(row >> BITS) * across) + np.int32(col >> BITS))
        inside = np.int32(np.int32((row & MASK) << BITS) | np.int32(col & MASK))
        line[i] = np.int32(np.int32(place << 2 * BITS) | inside)


@njit(cache=True, nogil=True)
def _lower(site: Any, scratch: Any, steps: Any) -> None:
    """Lower the cells that were passed, and wipe the marks."""
    table, patches, _, _ = site
    cols = table.shape[1]
    miss, least = np.int16(steps[0]), np.int16(-steps[2])
    for place in range(len(scratch.marked)):
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
