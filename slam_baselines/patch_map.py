"""Maps of many particles in patches that are shared until one of them writes: copy on write.

Most of a particle's map was drawn before it split from its siblings and is the same as theirs. A map is
a table of patches of 16 x 16 cells; children get their parent's table, and a patch that several tables
point at is copied by the first that draws into it. So memory goes with what differs.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lirs_wct.grid import OccupancyGrid
from lirs_wct.pose import Pose2
from slam_baselines.occupancy import STEP, UNKNOWN, UpdateConfig
from slam_baselines.patch_kernels import ABSENT, PATCH, MapView, Patches, enter_scans, steepness

Array = NDArray[np.float64]


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
        self.tables: NDArray[np.int32] = np.empty((particles, 0, 0), np.int32)
        self.corner: NDArray[np.int64] = np.zeros(2, np.int64)
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

    def descend(self, parents: NDArray[np.int64]) -> None:
        """Let map i become a copy of what map `parents[i]` was; copies share their patches."""
        self.tables = self.tables[parents]
        owners = np.bincount(self.tables[self.tables != ABSENT].ravel(), minlength=len(self.patches.owners))
        self.patches.owners[:] = owners
        _list_free(self.patches)

    def enter(
        self, poses: Array, origin: Array, hits: Array, free: Array, steep: NDArray[np.uint8], bound: int
    ) -> None:
        """Draw one scan into every map, each from its own pose.

        Args:
            poses: (particles, 3) x, y, yaw of `T_map_base`.
            origin: (3,) x, y of the laser in the levelled base frame, and its height in the map, metres.
            hits: (n, 3) where beams ended, likewise.
            free: (m, 3) ends of beams that met nothing up to there, likewise.
            steep: (n,) proven rise over run of each hit, in STEEP_STEP.
            bound: from which step of `steep` on a cell is a wall for sure.
        """
        ends = np.concatenate((hits, free, origin[None]))[:, :2]
        reach = float(np.sqrt((ends**2).sum(axis=1).max())) + 2 * self.resolution
        self._cover(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
        span = 2 * reach / self.resolution
        # A beam crosses at most two new patches each patch length, in either direction.
        needed = int(min((span / PATCH + 2) ** 2, (len(ends) + 1) * (span / PATCH + 3)))
        done = 0
        while done < len(poses):
            self._reserve(needed)
            done = enter_scans(
                self.tables,
                self.corner,
                self.patches,
                self.resolution,
                poses,
                origin,
                hits,
                free,
                steep,
                bound,
                np.array(self._steps),
                int(span) + 4,
                needed,
                done,
            )

    def view(self, particle: int, bound: int) -> MapView:
        """Return one map for the kernels; void after the next change."""
        return MapView(self.tables[particle], self.corner, self.patches, self.resolution, bound)

    def steepness(self, particle: int, points: Array) -> NDArray[np.uint8]:
        """Return (n,) what is proven of the cells under points (n, 2 or more) of the map frame."""
        out = np.zeros(len(points), np.uint8)
        steepness(self.tables[particle], self.corner, self.patches, self.resolution, points, out)
        return out

    def occupancy_grid(self, particle: int, bound: int) -> OccupancyGrid:
        """Return one map; hits not proven to be steeper than `bound` are unknown, not occupied."""
        table, p = self.tables[particle], self.patches
        rows, cols = table.shape
        lattice = table.ravel()
        known = (p.log_odds != UNKNOWN) & ~((p.log_odds > 0) & (p.steep < bound))
        values = np.where(known, p.log_odds * np.float32(STEP), np.float32(np.nan)).astype(np.float32)
        values = np.where((lattice == ABSENT)[:, None], np.float32(np.nan), values[lattice])
        grid = values.reshape(rows, cols, PATCH, PATCH).swapaxes(1, 2).reshape(rows * PATCH, cols * PATCH)
        r, c = (np.flatnonzero(~np.isnan(grid).all(axis=axis)) for axis in (1, 0))
        if len(r) == 0:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), self.resolution)
        row0, col0 = self.corner * PATCH + (r[0], c[0])
        corner = Pose2(float(col0 * self.resolution), float(row0 * self.resolution))
        return OccupancyGrid(grid[r[0] : r[-1] + 1, c[0] : c[-1] + 1].copy(), self.resolution, corner)

    def _cover(self, low: Array, high: Array) -> None:
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
