"""Grids of a finished submap, packed: what matching needs of them, and no more.

No scan enters a finished submap, so that little of its layers is read: which cells are known, and of those
with hits, which are few, what the matcher sees of them and the minimum slope by which they count as walls.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Any

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
        known: zlib, one bit a cell: whether beams came to it.
        hits: zlib, (n,) uint32 numbers of the cells that are more likely occupied than not.
        value: zlib, (n,) what the matcher sees of these where every hit is a wall.
        min_slope: zlib, (n,) their minimum slopes.
        shape: rows, columns.
        frame: lattice row and column of cell (0, 0), resolution in meters.
    """

    known: bytes
    hits: bytes
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
        known, steps, min_slope = known[box], steps[box].reshape(-1), level.layers.min_slope[box].reshape(-1)
        hits = np.flatnonzero(steps > 0)
        frame = level.grid.row0 + box[0].start, level.grid.col0 + box[1].start, level.resolution
        return PackedLevel(
            _packed(np.packbits(known)),
            _packed(hits.astype(np.uint32)),
            _packed(VALUE[steps[hits] + np.int16(128)]),
            _packed(min_slope[hits]),
            known.shape,
            frame,
        )

    def unpacked(self, wall_slope: int) -> ByteArray:
        """Return what the matcher sees where hits of a lower minimum slope than `wall_slope` are no walls."""
        value: ByteArray = self._known() * FREE
        hits = _unpacked(self.hits).view(np.uint32)
        walls = _unpacked(self.min_slope) >= wall_slope
        value[hits] = np.where(walls, _unpacked(self.value), np.uint8(UNSEEN))
        return value.reshape(self.shape)

    def known_cells(self) -> NDArray[np.int64]:
        """Return (n, 2) the lattice columns and rows of the cells that beams came to."""
        cells: NDArray[np.int64] = np.argwhere(self._known().reshape(self.shape))[:, ::-1]
        cells += np.array((self.frame[1], self.frame[0]))
        return cells

    def _known(self) -> ByteArray:
        """Return (cells,) 1 for those that beams came to."""
        return np.unpackbits(_unpacked(self.known), count=math.prod(self.shape))

    @property
    def nbytes(self) -> int:
        """Memory of the packed layers."""
        return len(self.known) + len(self.hits) + len(self.value) + len(self.min_slope)


def _packed(layer: NDArray[Any]) -> bytes:
    return zlib.compress(layer.data, FASTEST)


def _unpacked(packed: bytes) -> ByteArray:
    return np.frombuffer(zlib.decompress(packed), np.uint8)


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
