"""Range data of a scan, and probability grid of a submap, as in the original.

Coordinates are float32. Each voxel of a filter keeps one point, drawn by a generator with a fixed start
(reservoir sampling), so that the same scan gives the same points. Cells hold 16-bit values, updated by
tables: 1 to 32767 stand for 1 - p between 0.1 and 0.9; 0 is unknown and reads as p = 0.1. Row 0 is the
largest x, column 0 the largest y.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lirs_extensions.originals.cartographer.config import CartographerOriginalConfig
from lirs_wct.geometry import Float32Array, FloatArray, IntArray, LaserScan, Pose2, njit

UNSPLIT = 16
"""Elements that the sort of the C++ library does not split."""


class RangeData(NamedTuple):
    """Ends of beams in one frame, meters; the original draws all from the base.

    Attributes:
        origin: (2,) float32.
        returns: (n, 2) float32, hits.
        misses: (m, 2) float32, ends of the free part of beams without return.
    """

    origin: Float32Array
    returns: Float32Array
    misses: Float32Array

    def transform(self, pose: Pose2) -> RangeData:
        """Return the same data in the frame in which `pose` is given."""
        origin, returns, misses = (_transform(pose, points) for points in self)
        return RangeData(origin, returns, misses)

    def thin(self, size: float) -> RangeData:
        """Return one point a voxel of edge `size`, meters."""
        returns, misses = (voxel_filter(points, size) for points in (self.returns, self.misses))
        return RangeData(self.origin, returns, misses)


def read_scan(scan: LaserScan, config: CartographerOriginalConfig) -> RangeData:
    """Return a scan's data in the base frame, beams in the original's order."""
    c, mount = config, scan.T_base_laser.to_pose2()
    beams = np.flatnonzero(~np.isnan(scan.ranges) & (scan.ranges >= max(scan.range_min, c.min_range)))
    beams = beams[_sorted_order(len(beams))]
    ranges, angles = scan.ranges[beams].astype(np.float64), scan.angles[beams]
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    hit = (ranges < scan.range_max) & (ranges <= c.max_range)
    ends = ranges[hit, None] * directions[hit]
    free = c.missing_data_ray_length * directions[~hit]
    origin: Float32Array = np.zeros(2, np.float32)
    return RangeData(origin, *(_transform(mount, points) for points in (ends, free)))


@cache
def _sorted_order(count: int) -> IntArray:
    """Return the order (count,) in which the C++ library's unstable sort leaves equal elements.

    The original sorts the beams of a scan by their times, which are equal. The sort splits a range until it
    has at most 16 elements: it exchanges the first with the middle one, and reverses the others.
    """
    order = np.arange(count)

    def split(first: int, last: int) -> None:
        while last - first > UNSPLIT:
            middle = first + (last - first) // 2
            order[[first, middle]] = order[[middle, first]]
            order[first + 1 : last] = order[first + 1 : last][::-1].copy()
            cut = first + 1 + (last - first - 1) // 2
            split(cut, last)
            last = cut

    split(0, count)
    return order


def _transform(pose: Pose2, points: FloatArray | Float32Array) -> Float32Array:
    moved: Float32Array = pose.apply(points).astype(np.float32)
    return moved


def round_half_away(values: FloatArray | Float32Array) -> IntArray:
    """Return the nearest whole numbers; halves away from zero, as the C library rounds."""
    exact = values.astype(np.float64)
    whole: IntArray = np.trunc(exact + np.copysign(0.5, exact)).astype(np.int64)
    return whole


def voxel_filter(points: Float32Array, size: float) -> Float32Array:
    """Return one point of (n, 2) a voxel of edge `size`, in their order."""
    if len(points) == 0:
        return points
    cells = round_half_away(points / np.float32(size))
    _, voxel = np.unique(cells[:, 0] << 32 | cells[:, 1] & 0xFFFFFFFF, return_inverse=True)
    kept: Float32Array = points[_drawn(voxel, int(voxel.max()) + 1)]
    return kept


def adaptive_voxel_filter(points: Float32Array, config: CartographerOriginalConfig) -> Float32Array:
    """Return points of the coarsest voxels that keep enough, to a tenth of the edge."""
    c = config
    points = points[np.hypot(points[:, 0], points[:, 1]) <= c.adaptive_max_range]
    if len(points) <= c.adaptive_min_num_points:
        return points
    found = voxel_filter(points, c.adaptive_max_length)
    if len(found) >= c.adaptive_min_num_points:
        return found
    low = high = c.adaptive_max_length
    while high > 0.01 * c.adaptive_max_length:
        low = high / 2
        found = voxel_filter(points, low)
        if len(found) >= c.adaptive_min_num_points:
            break
        high = low
    # No edge is left in between if even the smallest one keeps too few.
    while (high - low) / low > 0.1:
        middle = (low + high) / 2
        candidate = voxel_filter(points, middle)
        if len(candidate) >= c.adaptive_min_num_points:
            low, found = middle, candidate
        else:
            high = middle
    return found


MULTIPLIER, MODULUS = 16807, 2147483647
"""Of the minimal standard generator (Park and Miller 1988)."""


@njit
def _drawn(voxel: Any, voxels: int) -> Any:
    """Return (n,) whether each point is the one that its voxel keeps.

    The k-th point of a voxel replaces the kept one with probability 1 / k; the draws from 1 to k reject the
    generator's last incomplete part, as the C++ library does.
    """
    count, kept = np.zeros(voxels, np.int64), np.zeros(voxels, np.int64)
    state = 1
    for i in range(len(voxel)):
        v = voxel[i]
        count[v] += 1
        k = count[v]
        drawn = k
        if k > 1:
            part = (MODULUS - 2) // k
            state = state * MULTIPLIER % MODULUS
            while state - 1 >= part * k:
                state = state * MULTIPLIER % MODULUS
            drawn = (state - 1) // part + 1
        if drawn == k:
            kept[v] = i
    mask = np.zeros(len(voxel), np.bool_)
    mask[kept] = True
    return mask


CellArray = NDArray[np.uint16]

MIN_COST, MAX_COST = np.float32(1) - np.float32(0.9), np.float32(0.9)
"""Smallest and largest 1 - p of a cell."""
VALUES = 32767
"""Number of values of known cells."""
MARK = 32768
"""Added to the cells that a scan has updated."""
INITIAL_CELLS = 100
"""Cells along an edge of a new grid."""
SUBCELLS = 1000
"""Parts of a cell's edge to which the ends of beams are rounded."""


_STEP = (MAX_COST - MIN_COST) / np.float32(VALUES - 1)
COST: Float32Array = np.arange(VALUES + 1, dtype=np.float32) * _STEP + (MIN_COST - _STEP)
"""(32768,) 1 - p by cell value."""
COST[0] = MAX_COST


@cache
def update_table(probability: float) -> CellArray:
    """Return (32768,) marked cell values after an observation of a probability, by the value before."""
    p = np.float32(probability)
    odds = p / (1 - p)
    before = np.float32(1) - COST
    after = odds * (before / (1 - before))
    after[0] = odds
    cost = np.clip(1 - after / (1 + after), MIN_COST, MAX_COST)
    scale = np.float32(VALUES - 1) / (MAX_COST - MIN_COST)
    values: CellArray = (np.floor((cost - MIN_COST) * scale + 0.5) + 1 + MARK).astype(np.uint16)
    return values


class ProbabilityGrid:
    """Square cells that grow around a center.

    The corner (2,) holds the largest x and y of the grid, meters.
    """

    def __init__(self, resolution: float, center: FloatArray) -> None:
        """Start with unknown cells around a center (2,), meters."""
        # The original reads the edge of a cell as float32.
        self.resolution = float(np.float32(resolution))
        self.corner = center + 0.5 * INITIAL_CELLS * self.resolution
        self.cells: CellArray = np.zeros((INITIAL_CELLS, INITIAL_CELLS), np.uint16)

    def insert(self, data: RangeData, hit: CellArray, miss: CellArray) -> None:
        """Update each cell that beams hit or pass once, by tables; a hit wins.

        The data are in the frame of the grid.
        """
        points = np.concatenate((data.origin[None], data.returns, data.misses))
        self._grow(points)
        ends = self._indices(points, self.resolution / SUBCELLS)
        _cast_rays(self.cells, ends, len(data.returns), hit, miss)
        self.cells &= np.uint16(MARK - 1)

    def indices(self, points: FloatArray | Float32Array) -> IntArray:
        """Return (..., 2) row and column of points (..., 2), also outside the grid."""
        return self._indices(points, self.resolution)

    def crop(self) -> ProbabilityGrid:
        """Return the smallest grid with all known cells, not to be inserted into."""
        known = self.cells > 0
        if not known.any():
            return self
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        small = ProbabilityGrid(self.resolution, np.zeros(2))
        small.corner = self.corner - self.resolution * np.array((rows[0], cols[0]))
        small.cells = self.cells[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1].copy()
        return small

    def _indices(self, points: FloatArray | Float32Array, edge: float) -> IntArray:
        return round_half_away((self.corner - points) / edge - 0.5)

    def _grow(self, points: Float32Array) -> None:
        """Double the grid until it holds points (n, 2)."""
        box = np.stack((points.min(axis=0) - np.float32(1e-6), points.max(axis=0) + np.float32(1e-6)))
        while True:
            at, (rows, cols) = self.indices(box), self.cells.shape
            if (at >= 0).all() and (at < (rows, cols)).all():
                return
            larger = np.zeros((2 * rows, 2 * cols), np.uint16)
            larger[rows // 2 : rows // 2 + rows, cols // 2 : cols // 2 + cols] = self.cells
            self.cells = larger
            self.corner = self.corner + self.resolution * np.array((rows // 2, cols // 2))


@njit
def _cast_rays(cells: Any, ends: Any, returns: int, hit: Any, miss: Any) -> None:
    """Update the cells by beams from ends[0], in subcells; the first `returns` hit."""
    for k in range(1, returns + 1):
        row, col = ends[k, 0] // SUBCELLS, ends[k, 1] // SUBCELLS
        if cells[row, col] < MARK:
            cells[row, col] = hit[cells[row, col]]
    for k in range(1, len(ends)):
        _miss_cells(cells, ends[0], ends[k], miss)


@njit
def _miss_cells(cells: Any, first: Any, last: Any, miss: Any) -> None:
    """Update all cells whose interior the segment between two centers of subcells meets."""
    if first[1] > last[1]:
        first, last = last, first
    # In half subcells, in which centers of subcells are odd and borders of cells even.
    edge = 2 * SUBCELLS
    u0, v0, u1, v1 = 2 * first[1] + 1, 2 * first[0] + 1, 2 * last[1] + 1, 2 * last[0] + 1
    du, dv = u1 - u0, v1 - v0
    for col in range(u0 // edge, u1 // edge + 1):
        if du == 0:
            low, high, unit = min(v0, v1), max(v0, v1), edge
        else:
            enter = v0 * du + (max(u0, col * edge) - u0) * dv
            leave = v0 * du + (min(u1, (col + 1) * edge) - u0) * dv
            low, high, unit = min(enter, leave), max(enter, leave), edge * du
        for row in range(low // unit, max(low // unit, -(-high // unit) - 1) + 1):
            if cells[row, col] < MARK:
                cells[row, col] = miss[cells[row, col]]
