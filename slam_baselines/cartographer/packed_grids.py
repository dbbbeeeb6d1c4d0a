"""Grids of a finished submap, packed: what matching needs of them, and no more.

No scan enters a finished submap, so that of its layers only two are read: what the matcher sees of a cell,
and the minimum slope by which a hit counts as a wall. Both are nearly constant over large areas.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import ByteArray, FloatArray
from slam_baselines.mapping.occupancy_map import FREE, UNKNOWN, UNSEEN, VALUE, OccupancyMap
from slam_baselines.mapping.pyramid import Levels, MapPyramid

FASTEST = 1
"""Level of zlib: a higher one gains little on layers like these."""


@dataclass(frozen=True, slots=True)
class PackedLevel:
    """One level, cropped to its known cells with a margin of one cell.

    Attributes:
        value: zlib, what the matcher sees where every hit is a wall.
        min_slope: zlib, minimum slopes of the cells.
        shape: rows, columns.
        frame: lattice row and column of cell (0, 0), resolution in metres.
    """

    value: bytes
    min_slope: bytes
    shape: tuple[int, int]
    frame: tuple[int, int, float]

    @staticmethod
    def of(level: OccupancyMap) -> PackedLevel:
        """Pack a level of a submap."""
        steps = level.layers.log_odds
        known = steps != UNKNOWN
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        box = tuple(slice(max(0, k[0] - 1), k[-1] + 2) if len(k) else slice(0, 0) for k in (rows, cols))
        value = np.take(VALUE, steps[box].astype(np.int16) + 128)
        frame = level.grid.row0 + box[0].start, level.grid.col0 + box[1].start, level.resolution
        min_slope = np.ascontiguousarray(level.layers.min_slope[box])
        return PackedLevel(
            zlib.compress(value.data, FASTEST), zlib.compress(min_slope.data, FASTEST), value.shape, frame
        )

    def unpacked(self, wall_slope: int) -> ByteArray:
        """Return what the matcher sees where hits of a lower minimum slope than `wall_slope` are no walls."""
        value = self._layer(self.value).copy()
        if wall_slope > 0:
            value[(value > FREE) & (self._layer(self.min_slope) < wall_slope)] = UNSEEN
        return value

    def known_cells(self) -> NDArray[np.int64]:
        """Return (n, 2) the lattice columns and rows of the cells that beams came to."""
        cells: NDArray[np.int64] = np.argwhere(self._layer(self.value) != UNSEEN)[:, ::-1]
        cells += np.array((self.frame[1], self.frame[0]))
        return cells

    def _layer(self, packed: bytes) -> ByteArray:
        return np.frombuffer(zlib.decompress(packed), np.uint8).reshape(self.shape)

    @property
    def nbytes(self) -> int:
        """Memory of the packed layers."""
        return len(self.value) + len(self.min_slope)


@dataclass(frozen=True, slots=True)
class PackedGrids:
    """All levels of a submap, finest first."""

    levels: tuple[PackedLevel, ...]

    @staticmethod
    def of(pyramid: MapPyramid) -> PackedGrids:
        """Pack the grids of a submap."""
        return PackedGrids(tuple(PackedLevel.of(level) for level in pyramid.maps))

    def unpacked(self, wall_slope: int) -> Levels:
        """Return the levels for matching (see PackedLevel.unpacked)."""
        frames: FloatArray = np.array([level.frame for level in self.levels], dtype=np.float64)
        return Levels(tuple(level.unpacked(wall_slope) for level in self.levels), frames)

    @property
    def nbytes(self) -> int:
        """Memory of all levels."""
        return sum(level.nbytes for level in self.levels)
