"""Occupancy map and its log-odds update by ray tracing, each cell once a scan.

Log-odds are kept in steps of 0.1 as int8, and in addition, as one byte, the probability that scan
matching reads: small maps stay in the cache.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import BoolArray, ByteArray, FloatArray, Int32Array, IntArray, OccupancyGrid, njit
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
    """Tracer of scans over a lattice of cells of an edge `resolution`, meters."""

    def __init__(self, resolution: float) -> None:
        self.resolution = resolution
        self._touched: ByteArray = np.zeros(0, np.uint8)
        self._mark = 0
        self._cells: IntArray = np.empty(0, np.int64)
        self._steps: Int32Array = np.empty(0, np.int32)

    def trace(self, scan: ScanPoints, box: FloatArray) -> Trace:
        """Return the cells that a scan in the lattice's frame meets; `box` (4,) bounds it."""
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
    """Fill a trace: cells of the beams' ends, then passed cells, each once.

    The last cell before a hit is spared: noise would erode the near side of the wall and so push it back.
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


BLOCK = 128
"""Bounds are multiples of this number of cells, so that the grid grows seldom."""


class GrowingGrid:
    """Layers of equal shape over one square lattice, cell (0, 0) at the frame's origin.

    Attributes:
        resolution: edge of a cell, meters.
        row0: lattice row (northward) of the arrays' row 0.
        col0: lattice column (eastward) of the arrays' column 0.
        layers: name -> (rows, cols) array; replaced by larger ones when the grid grows.
    """

    def __init__(self, resolution: float, layers: Mapping[str, tuple[DTypeLike, float]]) -> None:
        """Start empty; `layers` gives each layer's type and initial value."""
        self.resolution = resolution
        self.row0 = 0
        self.col0 = 0
        self._held = math.inf, math.inf, -math.inf, -math.inf
        self._fill = dict(layers)
        self.layers: dict[str, NDArray[Any]] = {name: _full((0, 0), spec) for name, spec in layers.items()}

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        rows, cols = next(iter(self.layers.values())).shape
        return rows, cols

    @property
    def nbytes(self) -> int:
        """Memory of all layers."""
        return sum(layer.nbytes for layer in self.layers.values())

    def ensure(self, west: float, south: float, east: float, north: float) -> bool:
        """Extend the grid by a box (meters); return whether the arrays were replaced."""
        held = self._held
        if west >= held[0] and south >= held[1] and east <= held[2] and north <= held[3]:
            return False
        rows, cols = self.shape
        c_lo, c_hi = _blocks(west / self.resolution, east / self.resolution)
        r_lo, r_hi = _blocks(south / self.resolution, north / self.resolution)
        if rows:
            r_lo, r_hi = min(r_lo, self.row0), max(r_hi, self.row0 + rows)
            c_lo, c_hi = min(c_lo, self.col0), max(c_hi, self.col0 + cols)
            if (r_hi - r_lo, c_hi - c_lo) == (rows, cols):
                return False
        at_row, at_col = self.row0 - r_lo, self.col0 - c_lo
        for name, old in self.layers.items():
            new = _full((r_hi - r_lo, c_hi - c_lo), self._fill[name])
            new[at_row : at_row + rows, at_col : at_col + cols] = old
            self.layers[name] = new
        self.row0, self.col0 = r_lo, c_lo
        # A box within these bounds needs no other blocks, by the rounding of _blocks.
        res = self.resolution
        self._held = (c_lo + 1) * res, (r_lo + 1) * res, (c_hi - 2) * res, (r_hi - 2) * res
        return True


def _full(shape: tuple[int, int], spec: tuple[DTypeLike, float]) -> NDArray[Any]:
    """Return a filled layer; zeros cost no memory until they are written."""
    dtype, value = spec
    return np.zeros(shape, dtype) if value == 0 else np.full(shape, value, dtype)


def _blocks(low: float, high: float) -> tuple[int, int]:
    """Round bounds in cells outward to whole blocks, with one cell to spare for interpolation."""
    return int((low - 1) // BLOCK) * BLOCK, int(-((-high - 2) // BLOCK)) * BLOCK


__all__ = ["FULL", "SLOPE_STEP", "STEP", "TOP_STEP", "UNKNOWN", "UNSEEN", "OccupancyMap", "UpdateConfig"]

SLOPE_STEP = 0.01
"""Rise over run of one step of the layer `min_slope`."""


@dataclass(frozen=True, kw_only=True)
class UpdateConfig(Checked):
    """Parameters of the map's update by a scan.

    Names and defaults of the first two are those of hector_mapping.

    Attributes:
        update_factor_free: Probability that a cell is occupied, given that a beam passed it.
        update_factor_occupied: Probability that a cell is occupied, given that a beam ended there.
        log_odds_limit: Largest absolute log-odds, so that the map can adapt to changes.
    """

    update_factor_free: float = limited(0.4, "(0, 0.5)")
    update_factor_occupied: float = limited(0.9, "(0.5, 1)")
    log_odds_limit: float = limited(4.0, "(0, 12]")

    @property
    def steps(self) -> tuple[int, int, int]:
        """Miss, hit and limit in steps of log-odds."""
        miss, hit = (
            max(1, round(abs(math.log(p / (1 - p))) / STEP))
            for p in (self.update_factor_free, self.update_factor_occupied)
        )
        return -miss, hit, round(self.log_odds_limit / STEP)


class OccupancyMap:
    """Occupancy map of one resolution that grows.

    Layers: `log_odds` (steps), `value` (for the matcher, without hits that may be ground), `min_slope`
    (largest minimum slope of the hits in a cell), `top` (largest height of these hits).

    Attributes:
        grid: Growing layers.
        frame: (3,) lattice row and column of the arrays' cell (0, 0), resolution in meters.
        layers: The grid's arrays.
    """

    def __init__(
        self, resolution: float, config: UpdateConfig | None = None, tracer: RayTracer | None = None
    ) -> None:
        """Start empty; other maps of this lattice may share `tracer`."""
        layers = {"log_odds": (np.int8, UNKNOWN), "value": (np.uint8, UNSEEN), "min_slope": (np.uint8, 0)}
        self.grid = GrowingGrid(resolution, layers | {"top": (np.int16, -32768)})
        self._config = config or UpdateConfig()
        self._steps = self._config.steps
        self._tracer = tracer or RayTracer(resolution)
        self._take_over()

    def empty_copy(self) -> OccupancyMap:
        """Return an empty map over the same lattice, with the same tracer."""
        return OccupancyMap(self.resolution, self._config, self._tracer)

    @property
    def resolution(self) -> float:
        """Edge of a cell, meters."""
        return self.grid.resolution

    def update(self, scan: ScanPoints, min_slopes: ByteArray, wall_slope: int, box: FloatArray) -> bool:
        """Enter a scan in the map frame; return whether the map grew into new arrays.

        Cells with (n,) minimum slopes of at least `wall_slope` are walls; the scan lies in the box (4,).
        """
        return self.enter(self._tracer.trace(scan, box), scan, min_slopes, wall_slope, box)

    def enter(
        self, trace: Trace, scan: ScanPoints, min_slopes: ByteArray, wall_slope: int, box: FloatArray
    ) -> bool:
        """Enter a scan that was traced over the same lattice; the rest as of update."""
        grew = self.reserve(box)
        corner = trace.corner[0] - self.grid.row0, trace.corner[1] - self.grid.col0
        enter_trace(self.layers, corner, trace, scan, min_slopes, wall_slope, self._steps)
        return grew

    def reserve(self, box: FloatArray) -> bool:
        """Allocate a box (4,), as of update; return whether the arrays were replaced."""
        grew = self.grid.ensure(*box.tolist())
        if grew:
            self._take_over()
        return grew

    def _take_over(self) -> None:
        g = self.grid
        self.layers = Layers(**g.layers)
        self.frame: FloatArray = np.array((g.row0, g.col0, g.resolution), dtype=np.float64)

    def take_over_log_odds(self) -> None:
        """Recompute the layer `value` from log-odds written from outside; every hit is a wall."""
        np.take(VALUE, self.layers.log_odds.astype(np.int16) + 128, out=self.layers.value)

    def revalue(self, wall_slope: int) -> None:
        """Recompute the layer `value`: hits below the minimum slope `wall_slope` are no walls."""
        # Free and unknown cells do not depend on the slope of walls.
        steps, value, min_slope = (
            layer.reshape(-1) for layer in (self.layers.log_odds, self.layers.value, self.layers.min_slope)
        )
        hits = np.flatnonzero(steps > 0)
        walls = min_slope[hits] >= wall_slope
        value[hits] = np.where(walls, VALUE[steps[hits] + np.int16(128)], np.uint8(UNSEEN))

    def occupancy_grid(self, wall_slope: int) -> OccupancyGrid:
        """Return the known cells; hits below the minimum slope `wall_slope` are unknown."""
        steps, min_slopes = self.layers.log_odds, self.layers.min_slope
        known = (steps != UNKNOWN) & ~((steps > 0) & (min_slopes < wall_slope))
        values = np.where(known, steps * np.float32(STEP), np.float32(np.nan)).astype(np.float32)
        return OccupancyGrid.of_lattice(values, self.resolution, self.grid.row0, self.grid.col0)


NO_WALL = 256
"""Wall slope above that of any hit."""
UNKNOWN = -128
"""Log-odds of an unknown cell."""
STEP = 0.1
"""Log-odds of one step of the layer `log_odds`."""
TOP_STEP = 0.01
"""Meters of one step of the layer `top`."""
STEPS_ABOVE = 10
"""Steps of `top` above a wall's highest hit from which on a beam passes over the wall."""
FULL = 255
"""Largest `value`: a certain wall."""
UNSEEN = 0
"""`value` of an unknown cell; any other means known."""

_odds = np.exp(STEP * np.arange(-128, 128))
VALUE = np.maximum(1, np.round(FULL * (_odds - 1) / (_odds + 1))).astype(np.uint8)
"""(256,) value of log-odds + 128: 2 p - 1 where that is above 0: free and unknown ground pull alike."""
VALUE[0] = UNSEEN
FREE = VALUE[128]
"""`value` of every known cell that is no hit."""


class Layers(NamedTuple):
    """The arrays of a map, (rows, cols) each."""

    log_odds: NDArray[np.int8]
    value: ByteArray
    min_slope: ByteArray
    top: NDArray[np.int16]


@njit
def enter_trace(
    layers: Any, corner: Any, trace: Any, scan: Any, min_slopes: Any, wall_slope: int, steps: Any
) -> None:
    """Raise cells where beams end, then lower those passed, except below a wall's top."""
    hits, hit_cells, cells = scan.hits, trace.hit_cells, trace.cells
    log_odds, value, min_slope, top = layers
    down, right = np.uintp(corner[0]), np.uintp(corner[1])
    for i in range(len(hits)):
        r, c = np.uintp(hit_cells[i] >> BITS) + down, np.uintp(hit_cells[i] & COLUMN) + right
        min_slope[r, c] = max(min_slope[r, c], min_slopes[i])
        top[r, c] = max(top[r, c], np.int16(min(max(hits[i, 2], -300.0), 300.0) / TOP_STEP))
    for i in range(len(hits)):
        if trace.hit_first[i]:
            r, c = np.uintp(hit_cells[i] >> BITS) + down, np.uintp(hit_cells[i] & COLUMN) + right
            _change(layers, r, c, steps[1], wall_slope, steps[2])
    # Nearly all cells that beams pass are without hits: their log-odds are read from a table.
    lowered = np.empty(256, np.int8)
    for before in range(-128, 128):
        lowered[before + 128] = _add_step(before, steps[0], steps[2])
    first = np.uintp(0)
    for b in range(len(trace.ends)):
        end = np.uintp(trace.ends[b])
        for i in range(first, end):
            r, c = np.uintp(cells[i] >> BITS) + down, np.uintp(cells[i] & COLUMN) + right
            if log_odds[r, c] <= 0:
                if log_odds[r, c] == UNKNOWN:  # else it is known to be free: nothing new for the matcher
                    value[r, c] = FREE
                log_odds[r, c] = lowered[np.uintp(np.int64(log_odds[r, c]) + 128)]
                continue
            if wall_slope > 0 and min_slope[r, c] >= wall_slope:
                height = scan.origin[2] + trace.steps[i] * trace.rise[b]
                if height / TOP_STEP > top[r, c] + STEPS_ABOVE:
                    continue
            _change(layers, r, c, steps[0], wall_slope, steps[2])
        first = end


@njit(inline="always")
def _change(layers: Any, r: int, c: int, step: int, wall_slope: int, limit: int) -> None:
    """Add to the log-odds of a cell and update its `value`."""
    after = _add_step(np.int64(layers.log_odds[r, c]), step, limit)
    layers.log_odds[r, c] = after
    layers.value[r, c] = (
        UNSEEN if after > 0 and layers.min_slope[r, c] < wall_slope else VALUE[np.uintp(after + 128)]
    )


@njit(inline="always")
def _add_step(before: int, step: int, limit: int) -> int:
    """Return the log-odds of a cell after a step."""
    return min(limit, max(-limit, (0 if before == UNKNOWN else before) + step))


@njit
def bounding_box(scan: Any) -> Any:
    """Return the (4,) box of a scan: west, south, east, north, meters."""
    west = east = scan.origin[0]
    south = north = scan.origin[1]
    for ends in (scan.hits, scan.free):
        for i in range(len(ends)):
            west, east = min(west, ends[i, 0]), max(east, ends[i, 0])
            south, north = min(south, ends[i, 1]), max(north, ends[i, 1])
    return np.array((west, south, east, north))


def union_of(boxes: Sequence[FloatArray]) -> FloatArray:
    """Return the (4,) box, west, south, east, north, that holds all boxes."""
    all_of_them = np.array(boxes)
    return np.concatenate((all_of_them[:, :2].min(axis=0), all_of_them[:, 2:].max(axis=0)))


class Levels(NamedTuple):
    """Arrays of a pyramid for the matcher's kernels, finest level first.

    Attributes:
        values: (rows, cols) uint8 layer `value` of each level.
        frames: (levels, 3) lattice row and column of cell (0, 0), resolution in meters.
    """

    values: tuple[Any, ...]
    frames: FloatArray


class MapPyramid:
    """Occupancy maps of growing cell size, finest first, and their arrays as Levels."""

    def __init__(self, maps: tuple[OccupancyMap, ...]) -> None:
        self.maps = maps
        self.refresh()

    def refresh(self) -> None:
        """Take over the maps' arrays; needed whenever one of them grew."""
        self.levels = Levels(
            tuple(level.layers.value for level in self.maps), np.array([level.frame for level in self.maps])
        )
