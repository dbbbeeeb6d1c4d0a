"""Copy-on-write occupancy maps of many particles in shared patches."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray, Int32Array, IntArray
from lirs_wct.geometry import OccupancyGrid, Pose2
from lirs_wct.kernels import njit
from slam_baselines.gmapping.patches import (
    ABSENT,
    BITS,
    MASK,
    PATCH,
    Patches,
    PatchTables,
    reserve_patches,
    resize,
)
from slam_baselines.gmapping.scan_entry import Scratch, enter_scans
from slam_baselines.mapping.occupancy_map import STEP, UNKNOWN, UpdateConfig
from slam_baselines.scan.leveling import ScanPoints


class PatchMaps(PatchTables[Patches]):
    """Occupancy maps of a set of particles."""

    def __init__(self, particles: int, resolution: float) -> None:
        super().__init__(particles, resolution, resize(None, 256, 64))
        self._scratch = Scratch.of(0, 0)
        self._steps = UpdateConfig().steps

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
        r, c = (np.flatnonzero(~np.isnan(grid).all(axis=axis)) for axis in (1, 0))
        if len(r) == 0:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), self.resolution)
        row0, col0 = self.corner * PATCH + (r[0], c[0])
        corner = Pose2(float(col0 * self.resolution), float(row0 * self.resolution))
        return OccupancyGrid(grid[r[0] : r[-1] + 1, c[0] : c[-1] + 1].copy(), self.resolution, corner)


class PatchMapView(NamedTuple):
    """One particle's map for the kernels.

    Attributes:
        table: (rows, cols) int32, the patch at each place.
        corner: (2,) row and column of the table's first patch.
        patches: all patches.
        resolution: edge of a cell, meters.
        wall_slope: minimum slope from which on a hit is a wall, SLOPE_STEP.
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


@njit(cache=True, nogil=True)
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
