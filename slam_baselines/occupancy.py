"""The occupancy map and its update: log-odds by ray tracing, every cell at most once a scan.

Log-odds are kept in steps of 0.1 as int8, and beside them, as one byte, the probability that scan
matching reads: small maps stay in the cache.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.grid import OccupancyGrid
from lirs_wct.pose import Pose2
from slam_baselines.growing import GrowingGrid

STEP = 0.1
"""Log-odds of one step."""
UNKNOWN = -128
"""Marks a cell that no beam has touched."""
STEEP_STEP = 0.01
"""Rise over run of one step of the layer `steep`."""
TOP_STEP = 0.01
"""Metres of one step of the layer `top`."""

FULL = 255
"""A `value` of this is a wall for sure."""
UNSEEN = 0
"""A `value` of this says nothing; any other that the cell is known."""

_odds = np.exp(STEP * np.arange(-128, 128))
_VALUE = np.maximum(1, np.round(FULL * (_odds - 1) / (_odds + 1))).astype(np.uint8)
_VALUE[0] = UNSEEN


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
            raise ConfigError(f"update_factor_occupied must be within (0.5, 1), got {self.update_factor_occupied}")
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

    Layers: `log_odds` (steps), `value` (probability as the matcher sees it: unknown where a hit may have
    been ground), `steep` (largest proven rise over run of what was hit there), `top` (largest height at
    which it was hit).
    """

    def __init__(self, resolution: float, config: UpdateConfig | None = None) -> None:
        layers = {"log_odds": (np.int8, UNKNOWN), "value": (np.uint8, UNSEEN), "steep": (np.uint8, 0)}
        self.grid = GrowingGrid(resolution, layers | {"top": (np.int16, -32768)})
        self._steps = (config or UpdateConfig()).steps
        self._touched: NDArray[np.uint8] = np.zeros(0, np.uint8)

    @property
    def resolution(self) -> float:
        """Edge of a cell, metres."""
        return self.grid.resolution

    def update(
        self, origin: NDArray[np.float64], hits: NDArray[np.float64], free: NDArray[np.float64], steep: NDArray[np.uint8], bound: int
    ) -> bool:
        """Enter a scan; return whether the arrays were replaced because the map grew.

        Args:
            origin: (3,) x, y, height of the laser in the map frame, metres.
            hits: (n, 3) where beams ended.
            free: (m, 3) ends of beams that met nothing up to there.
            steep: (n,) proven rise over run of each hit, in STEEP_STEP.
            bound: from which step of `steep` on a cell is a wall for sure.
        """
        ends = np.concatenate((hits, free, origin[None]))
        low, high = ends.min(axis=0), ends.max(axis=0)
        grew = self.grid.ensure(low[0], low[1], high[0], high[1])
        window = np.array((
            math.floor(low[1] / self.resolution) - 1, math.floor(low[0] / self.resolution) - 1,
            math.floor(high[1] / self.resolution) + 2, math.floor(high[0] / self.resolution) + 2,
        ))  # fmt: skip
        size = int((window[2] - window[0]) * (window[3] - window[1]))
        if len(self._touched) < size:
            self._touched = np.empty(size * 3 // 2, np.uint8)
        layers = self.grid.layers
        _enter_scan(
            layers["log_odds"], layers["value"], layers["steep"], layers["top"], self.grid.row0, self.grid.col0, self.resolution,
            self._touched, window, origin, hits, free, steep, bound, *self._steps,
        )  # fmt: skip
        return grew

    def revalue(self, bound: int) -> None:
        """Let the matcher see as walls only those hits that are proven to be steeper than `bound`."""
        layers = self.grid.layers
        steps, value = layers["log_odds"], layers["value"]
        np.take(_VALUE, steps.astype(np.int16) + 128, out=value)
        value[(steps > 0) & (layers["steep"] < bound)] = UNSEEN

    def steepness(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return (n,) what is proven of the cells under points (n, 2 or more), in STEEP_STEP."""
        g = self.grid
        out = np.zeros(len(points), np.uint8)
        _look_up(g.layers["steep"], g.row0, g.col0, g.resolution, points, out)
        return out

    def occupancy_grid(self, bound: int) -> OccupancyGrid:
        """Return what is known; hits not proven to be steeper than `bound` are unknown, not occupied."""
        steps, steep = self.grid.layers["log_odds"], self.grid.layers["steep"]
        known = (steps != UNKNOWN) & ~((steps > 0) & (steep < bound))
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        if len(rows) == 0:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), self.resolution)
        box = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        values = np.where(known[box], steps[box] * np.float32(STEP), np.float32(np.nan)).astype(np.float32)
        corner = Pose2((self.grid.col0 + cols[0]) * self.resolution, (self.grid.row0 + rows[0]) * self.resolution)
        return OccupancyGrid(values, self.resolution, corner)


@njit(cache=True)
def _enter_scan(
    log_odds, value, steepness, top, row0, col0, resolution, touched, window, origin, hits, free, steep, bound, miss, hit, limit
):  # fmt: skip
    """Raise the cells where beams end, then lower those that beams pass; no cell twice, a hit wins."""
    width = window[3] - window[1]
    touched[: (window[2] - window[0]) * width] = 0
    for i in range(len(hits)):
        row, col = int(np.floor(hits[i, 1] / resolution)), int(np.floor(hits[i, 0] / resolution))
        mark = (row - window[0]) * width + col - window[1]
        r, c = row - row0, col - col0
        steepness[r, c] = max(steepness[r, c], steep[i])
        height = np.int16(hits[i, 2] / TOP_STEP)
        top[r, c] = max(top[r, c], height)
        if touched[mark] == 0:
            touched[mark] = 1
            before = log_odds[r, c]
            after = min(limit, (0 if before == UNKNOWN else before) + hit)
            log_odds[r, c] = after
            value[r, c] = UNSEEN if after > 0 and steepness[r, c] < bound else _VALUE[after + 128]
    for i in range(len(hits)):
        _pass(log_odds, value, steepness, top, row0, col0, resolution, touched, window, origin, hits[i], False, bound, miss, limit)
    for i in range(len(free)):
        _pass(log_odds, value, steepness, top, row0, col0, resolution, touched, window, origin, free[i], True, bound, miss, limit)


@njit(cache=True)
def _pass(log_odds, value, steepness, top, row0, col0, resolution, touched, window, origin, end, to_end, bound, miss, limit):
    """Lower the cells between the laser and the end of one beam.

    A beam that passes above where a proven wall was hit says nothing about the wall.
    """
    width = window[3] - window[1]
    x, y = origin[0] / resolution, origin[1] / resolution
    dx, dy = end[0] / resolution - x, end[1] / resolution - y
    last_row, last_col = int(np.floor(y + dy)), int(np.floor(x + dx))
    steps = int(max(abs(dx), abs(dy))) + 1
    dx, dy, dz = dx / steps, dy / steps, (end[2] - origin[2]) / steps
    for k in range(steps + 1 if to_end else steps - 1):
        row, col = int(np.floor(y + k * dy)), int(np.floor(x + k * dx))
        if row == last_row and col == last_col and not to_end:
            break
        mark = (row - window[0]) * width + col - window[1]
        if touched[mark]:
            continue
        touched[mark] = 1
        r, c = row - row0, col - col0
        before = log_odds[r, c]
        if before > 0 and bound > 0 and steepness[r, c] >= bound and (origin[2] + k * dz) / TOP_STEP > top[r, c] + 10:
            continue
        after = max(-limit, (0 if before == UNKNOWN else before) + miss)
        log_odds[r, c] = after
        value[r, c] = UNSEEN if after > 0 and steepness[r, c] < bound else _VALUE[after + 128]


@njit(cache=True)
def _look_up(layer, row0, col0, resolution, points, out):
    """Read a layer at points; what lies outside keeps the value in `out`."""
    rows, cols = layer.shape
    for i in range(len(points)):
        r, c = int(np.floor(points[i, 1] / resolution)) - row0, int(np.floor(points[i, 0] / resolution)) - col0
        if 0 <= r < rows and 0 <= c < cols:
            out[i] = layer[r, c]
