"""The occupancy map and its update: log-odds by ray tracing, every cell at most once a scan.

Log-odds are kept in steps of 0.1 as int8, and beside them, as one byte, the probability that scan
matching reads: small maps stay in the cache.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.grid import OccupancyGrid
from lirs_wct.pose import Pose2
from slam_baselines.growing import GrowingGrid
from slam_baselines.ray_update import (
    FULL,
    STEP,
    TOP_STEP,
    UNKNOWN,
    UNSEEN,
    VALUE,
    Layers,
    enter_scan,
    look_up,
)

Array = NDArray[np.float64]
Steps = NDArray[np.uint8]

__all__ = ["FULL", "STEEP_STEP", "STEP", "TOP_STEP", "UNKNOWN", "UNSEEN", "OccupancyMap", "UpdateConfig"]

STEEP_STEP = 0.01
"""Rise over run of one step of the layer `steep`."""


@dataclass(frozen=True, kw_only=True)
class UpdateConfig:
    """How one scan changes the map; names and defaults of the first two as in hector_mapping.

    Attributes:
        update_factor_free: probability that a cell is occupied, given that a beam passed it.
        update_factor_occupied: probability that a cell is occupied, given that a beam ended there.
        limit: log-odds are kept within +-limit, so that the map can change its mind.

    Raises:
        ConfigError: a probability on the wrong side of 0.5, or a limit beyond what the map can hold.
    """

    update_factor_free: float = 0.4
    update_factor_occupied: float = 0.9
    limit: float = 4.0

    def __post_init__(self) -> None:
        if not 0 < self.update_factor_free < 0.5:
            raise ConfigError(f"update_factor_free must be within (0, 0.5), got {self.update_factor_free}")
        if not 0.5 < self.update_factor_occupied < 1:
            raise ConfigError(
                f"update_factor_occupied must be within (0.5, 1), got {self.update_factor_occupied}"
            )
        if not 0 < self.limit <= 12:
            raise ConfigError(f"limit must be within (0, 12], got {self.limit}")

    @property
    def steps(self) -> tuple[int, int, int]:
        """Miss, hit and limit in steps of log-odds."""
        miss, hit = (
            max(1, round(abs(math.log(p / (1 - p))) / STEP))
            for p in (self.update_factor_free, self.update_factor_occupied)
        )
        return -miss, hit, round(self.limit / STEP)


class OccupancyMap:
    """An occupancy map of one resolution that grows.

    Layers: `log_odds` (steps), `value` (what the matcher sees: nothing where a hit may have been ground),
    `steep` (largest proven rise over run of what was hit there), `top` (largest height at which it was hit).

    Attributes:
        grid: the layers.
        frame: (3,) lattice row and column of the arrays' cell (0, 0), resolution in metres.
        layers: the grid's arrays.
    """

    def __init__(self, resolution: float, config: UpdateConfig | None = None) -> None:
        layers = {"log_odds": (np.int8, UNKNOWN), "value": (np.uint8, UNSEEN), "steep": (np.uint8, 0)}
        self.grid = GrowingGrid(resolution, layers | {"top": (np.int16, -32768)})
        self._steps = (config or UpdateConfig()).steps
        self._touched: NDArray[np.uint8] = np.zeros(0, np.uint8)
        self._mark = 0
        self._take_over()

    @property
    def resolution(self) -> float:
        """Edge of a cell, metres."""
        return self.grid.resolution

    def update(self, origin: Array, hits: Array, free: Array, steep: Steps, bound: int, box: Array) -> bool:
        """Enter a scan; return whether the arrays were replaced because the map grew.

        Args:
            origin: (3,) x, y, height of the laser in the map frame, metres.
            hits: (n, 3) where beams ended.
            free: (m, 3) ends of beams that met nothing up to there.
            steep: (n,) proven rise over run of each hit, in STEEP_STEP.
            bound: from which step of `steep` on a cell is a wall for sure.
            box: (4,) west, south, east, north of all of them, metres.
        """
        bounds = box.tolist()
        grew = self.grid.ensure(*bounds)
        if grew:
            self._take_over()
        west, south, east, north = (math.floor(v / self.resolution) for v in bounds)
        corner = south - 1 - self.grid.row0, west - 1 - self.grid.col0
        touched = self._scratch(north - south + 3, east - west + 3)
        enter_scan(
            self.layers,
            self.frame,
            touched,
            self._mark,
            corner,
            origin,
            hits,
            free,
            steep,
            bound,
            self._steps,
        )
        return grew

    def _scratch(self, rows: int, cols: int) -> NDArray[np.uint8]:
        """Return a scratch that nowhere holds the new mark; it is wiped only when the marks run out."""
        if len(self._touched) < rows * cols:
            self._touched, self._mark = np.zeros(rows * cols * 3 // 2, np.uint8), 0
        elif self._mark == 255:
            self._touched.fill(0)
            self._mark = 0
        self._mark += 1
        return self._touched[: rows * cols].reshape(rows, cols)

    def _take_over(self) -> None:
        g = self.grid
        self.layers = Layers(**g.layers)
        self.frame: Array = np.array((g.row0, g.col0, g.resolution), dtype=np.float64)

    def revalue(self, bound: int) -> None:
        """Let the matcher see as walls only those hits that are proven to be steeper than `bound`."""
        steps, value = self.layers.log_odds, self.layers.value
        np.take(VALUE, steps.astype(np.int16) + 128, out=value)
        value[(steps > 0) & (self.layers.steep < bound)] = UNSEEN

    def steepness(self, points: Array) -> Steps:
        """Return (n,) what is proven of the cells under points (n, 2 or more), in STEEP_STEP."""
        out = np.zeros(len(points), np.uint8)
        look_up(self.layers.steep, self.frame, points, out)
        return out

    def occupancy_grid(self, bound: int) -> OccupancyGrid:
        """Return what is known; hits not proven to be steeper than `bound` are unknown, not occupied."""
        steps, steep = self.layers.log_odds, self.layers.steep
        known = (steps != UNKNOWN) & ~((steps > 0) & (steep < bound))
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        if len(rows) == 0:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), self.resolution)
        box = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        values = np.where(known[box], steps[box] * np.float32(STEP), np.float32(np.nan)).astype(np.float32)
        corner = Pose2(
            (self.grid.col0 + cols[0]) * self.resolution, (self.grid.row0 + rows[0]) * self.resolution
        )
        return OccupancyGrid(values, self.resolution, corner)
