"""Ray tracing of a scan over a lattice: cells hit and cells passed, each once.

The traced cells do not depend on the map: one trace updates all maps of the same resolution and frame.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import BoolArray, ByteArray, FloatArray, Int32Array, IntArray
from lirs_wct.kernels import njit
from slam_baselines.leveling import ScanPoints

BITS = 32
ONE = float(1 << BITS)
"""A cell in fixed point; a cell's number is its row, times this, plus its column."""
COLUMN = (1 << BITS) - 1
"""Mask of the column in a cell's number."""


class Trace(NamedTuple):
    """Window numbers of the cells that a scan meets; void after the next trace.

    Attributes:
        corner: lattice row and column of the window.
        hit_cells: (n,) where the beams with a hit end.
        hit_first: (n,) whether a beam is the first to end in its cell.
        cells: (k,) passed, none of them hit, each once, beam by beam.
        steps: (k,) step of the beam at which it passed the cell.
        ends: (beams,) where a beam's cells end.
        rise: (beams,) of a beam from step to step, meters.
    """

    corner: tuple[int, int]
    hit_cells: IntArray
    hit_first: BoolArray
    cells: IntArray
    steps: Int32Array
    ends: IntArray
    rise: FloatArray


class RayTracer:
    """Traces scans, one after the other, over a lattice.

    Attributes:
        resolution: edge of a cell, meters.
    """

    def __init__(self, resolution: float) -> None:
        self.resolution = resolution
        self._touched: ByteArray = np.zeros(0, np.uint8)
        self._mark = 0
        self._cells: IntArray = np.empty(0, np.int64)
        self._steps: Int32Array = np.empty(0, np.int32)

    def trace(self, scan: ScanPoints, box: FloatArray) -> Trace:
        """Return the cells that a scan meets.

        Args:
            scan: in the lattice's frame.
            box: (4,) west, south, east, north of the scan, meters.
        """
        west, south, east, north = (math.floor(v / self.resolution) for v in box.tolist())
        touched = self._blank(north - south + 3, east - west + 3)
        hits, beams = len(scan.hits), len(scan.hits) + len(scan.free)
        trace = Trace(
            (south - 1, west - 1), np.empty(hits, np.int64), np.empty(hits, np.bool_), self._cells,
            self._steps, np.empty(beams, np.int64), np.empty(beams),
        )  # fmt: skip
        trace_scan(
            scan, self.resolution, touched, self._mark, np.empty(sum(touched.shape) + 4, np.int64), trace
        )
        return trace

    def _blank(self, rows: int, cols: int) -> ByteArray:
        """Return a scratch without the new mark; it is cleared only when marks run out."""
        if len(self._touched) < rows * cols:
            size = rows * cols * 3 // 2
            self._touched, self._mark = np.zeros(size, np.uint8), 0
            self._cells, self._steps = np.empty(size + 1, np.int64), np.empty(size + 1, np.int32)
        elif self._mark == 255:
            self._touched.fill(0)
            self._mark = 0
        self._mark += 1
        return self._touched[: rows * cols].reshape(rows, cols)


@njit
def trace_scan(scan: Any, resolution: float, touched: Any, mark: int, line: Any, out: Any) -> None:
    """Fill a trace: cells of the beams' ends, then passed cells; each once, a hit wins.

    The last cell before a hit is spared: noise would erode the near side of the wall and so push it back.

    Args:
        scan: in the lattice's frame.
        resolution: edge of a cell, meters.
        touched: (rows, cols) of the window, nowhere `mark`; holds all beams.
        mark: of the cells that this scan has touched.
        line: (n,) scratch for the cells of one beam.
        out: the trace.
    """
    origin, hits, free = scan
    cells, numbers, flat = out.cells, out.steps, touched.ravel()
    scale, across, north, east = 1 / resolution, touched.shape[1], out.corner[0], out.corner[1]
    for i in range(len(hits)):
        row, col = int(hits[i, 1] * scale - north), int(hits[i, 0] * scale - east)
        out.hit_cells[i] = (row << BITS) | col
        out.hit_first[i] = touched[row, col] != mark
        touched[row, col] = mark
    y, x, z = origin[1] * scale - north, origin[0] * scale - east, origin[2]
    # Unsigned: an index that might be negative costs half of the time.
    m, tag = np.uintp(0), np.uint8(mark)
    for b in range(len(out.ends)):
        spared = b < len(hits)
        end = hits[b] if spared else free[b - len(hits)]
        dy, dx = end[1] * scale - north - y, end[0] * scale - east - x
        n = int(max(abs(dx), abs(dy))) + 1
        out.rise[b] = (end[2] - z) / n
        count = n - 1 if spared else n + 1
        _number_cells(line, count, np.int64(y * ONE), np.int64(x * ONE), dy / n, dx / n)
        # Without a branch: whether a cell is new is unpredictable.
        for k in range(count):
            cell = np.uintp(line[k])
            at = (cell >> np.uintp(BITS)) * np.uintp(across) + (cell & np.uintp(COLUMN))
            cells[m], numbers[m] = line[k], k
            m += np.uintp(flat[at] != tag)
            flat[at] = tag
        out.ends[b] = m


@njit
def _number_cells(line: Any, count: int, v: int, u: int, dy: float, dx: float) -> None:
    """Fill the first `count` numbers of `line` with the cells of a beam, by SIMD."""
    dv, du = np.int64(dy * ONE), np.int64(dx * ONE)
    for k in range(count):
        line[k] = ((v + k * dv) & ~COLUMN) | ((u + k * du) >> BITS)


@njit
def line_cells(row: int, col: int, last_row: int, last_col: int) -> Any:
    """Return the cells (n, 2) of Bresenham's line: row and column, without the last."""
    dy, dx = last_row - row, last_col - col
    along, across = max(abs(dx), abs(dy)), min(abs(dx), abs(dy))
    cells = np.empty((along, 2), np.int64)
    error = along // 2
    for k in range(along):
        cells[k, 0], cells[k, 1] = row, col
        error += across
        sideways = error >= along
        if sideways:
            error -= along
        if abs(dx) >= abs(dy) or sideways:
            col += 1 if dx > 0 else -1
        if abs(dx) < abs(dy) or sideways:
            row += 1 if dy > 0 else -1
    return cells
