"""Patches of cells, and the kernels that draw scans into maps that share them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slam_baselines.occupancy import TOP_STEP, UNKNOWN

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
        steep: (p, 256) uint8, largest proven rise over run of what was hit there, STEEP_STEP.
        top: (p, 256) int16, largest height at which it was hit, TOP_STEP.
        owners: (p,) int32, tables that point at the patch; 0 = free.
        free: (1 + p,) int32, how many patches are free, and then which.
    """

    log_odds: NDArray[np.int8]
    hits: NDArray[np.uint8]
    mean: NDArray[np.uint16]
    steep: NDArray[np.uint8]
    top: NDArray[np.int16]
    owners: NDArray[np.int32]
    free: NDArray[np.int32]


class MapView(NamedTuple):
    """One particle's map as the kernels see it.

    Attributes:
        table: (rows, cols) int32, the patch at each place.
        corner: (2,) row and column of the table's first patch.
        patches: all patches.
        resolution: edge of a cell, metres.
        bound: proven rise over run, in STEEP_STEP, from which on a hit is a wall.
    """

    table: NDArray[np.int32]
    corner: NDArray[np.int64]
    patches: Patches
    resolution: float
    bound: int


@njit(cache=True)
def _own(table, patches, row, col):  # type: ignore[no-untyped-def]
    """Put a patch of its own, new or copied, at a place of a table; return which."""
    p = table[row, col]
    patches.free[0] -= 1
    q = patches.free[1 + patches.free[0]]
    if p == ABSENT:
        patches.log_odds[q] = UNKNOWN
        patches.hits[q] = 0
        patches.steep[q] = 0
    else:
        patches.owners[p] -= 1
        patches.log_odds[q] = patches.log_odds[p]
        patches.hits[q] = patches.hits[p]
        patches.steep[q] = patches.steep[p]
        # Most patches are free space: what was never hit has neither mean nor top.
        if patches.hits[q].any():
            patches.mean[q] = patches.mean[p]
            patches.top[q] = patches.top[p]
    patches.owners[q] = 1
    table[row, col] = q
    return q


@njit(cache=True)
def enter_scans(  # type: ignore[no-untyped-def]
    tables, corner, patches, res, poses, origin, hits, free, steep, bound, steps, side, needed, first
):
    """Draw the scan into the maps from the first on; return how many are done when patches run out."""
    touched = np.empty((side, side), np.uint8)
    for k in range(first, len(poses)):
        if patches.free[0] < needed:
            return k
        touched[:] = 0
        x, y = poses[k, 0] / res, poses[k, 1] / res
        c, s = np.cos(poses[k, 2]) / res, np.sin(poses[k, 2]) / res
        start = np.array((x + c * origin[0] - s * origin[1], y + s * origin[0] + c * origin[1], origin[2]))
        window = np.array((int(np.floor(y)) - side // 2, int(np.floor(x)) - side // 2))
        for i in range(len(hits)):
            u, v = x + c * hits[i, 0] - s * hits[i, 1], y + s * hits[i, 0] + c * hits[i, 1]
            _hit(tables[k], corner, patches, touched, window, u, v, hits[i, 2], steep[i], steps)
        for i in range(len(hits) + len(free)):
            to_end = i >= len(hits)
            end = free[i - len(hits)] if to_end else hits[i]
            u, v = x + c * end[0] - s * end[1], y + s * end[0] + c * end[1]
            _pass(tables[k], corner, patches, touched, window, start, u, v, end[2], to_end, bound, steps)
    return len(poses)


@njit(cache=True)
def _hit(table, corner, patches, touched, window, u, v, z, steep, steps):  # type: ignore[no-untyped-def]
    """Raise the cell where a beam ends (u, v in cells), once a scan, and move its mean."""
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
    patches.steep[p, cell] = max(patches.steep[p, cell], steep)
    top = np.int16(z / TOP_STEP)
    patches.top[p, cell] = top if first else max(patches.top[p, cell], top)
    if touched[row - window[0], col - window[1]] == 0:
        touched[row - window[0], col - window[1]] = 1
        before = patches.log_odds[p, cell]
        patches.log_odds[p, cell] = min(steps[2], (0 if before == UNKNOWN else before) + steps[1])


@njit(cache=True)
def _pass(table, corner, patches, touched, window, start, u, v, z, to_end, bound, steps):  # type: ignore[no-untyped-def]
    """Lower the cells between the laser and the end of one beam (u, v in cells), each once a scan.

    A beam that passes above where a proven wall was hit says nothing about the wall.
    """
    log_odds, steep, tops, owners = patches.log_odds, patches.steep, patches.top, patches.owners
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
        if before > 0 and 0 < bound <= steep[p, cell] and above:
            continue
        log_odds[p, cell] = max(-most, (0 if before == UNKNOWN else before) + miss)


@njit(cache=True)
def steepness(table, corner, patches, res, points, out):  # type: ignore[no-untyped-def]
    """Read the layer `steep` of one map at points; 0 where nothing was drawn."""
    rows, cols = table.shape
    for i in range(len(points)):
        row, col = int(np.floor(points[i, 1] / res)), int(np.floor(points[i, 0] / res))
        r, c = (row >> BITS) - corner[0], (col >> BITS) - corner[1]
        if 0 <= r < rows and 0 <= c < cols and table[r, c] != ABSENT:
            out[i] = patches.steep[table[r, c], ((row & MASK) << BITS) | (col & MASK)]
