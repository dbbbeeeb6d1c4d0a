"""Trimming of redundant submaps, whose places newer submaps cover.

A robot that repeats a path sees nothing new; without trimming, its memory would grow with time and not with
the area. After Cartographer's trimmer of overlapping submaps: of each place, the newest submaps are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray, IntArray
from lirs_wct.geometry import Pose2
from slam_baselines.cartographer.config import TrimmingConfig
from slam_baselines.cartographer.submap import Submap


@dataclass(frozen=True, slots=True)
class _Covered:
    """Bit mask of the squares that a submap covers, in its own frame.

    Attributes:
        bits: packed rows.
        cols: number of squares in a row.
        corner: (2,) column and row of the first square.
    """

    bits: ByteArray
    cols: int
    corner: IntArray

    @staticmethod
    def by(points: FloatArray, square: float) -> _Covered:
        """Return the squares, of edge `square`, that (n, 2) points lie in."""
        cells = np.floor(points / square).astype(np.int64)
        corner = cells.min(axis=0, initial=0)
        cols, rows = (cells.max(axis=0, initial=0) - corner + 1).tolist()
        mask = np.zeros((rows, cols), np.bool_)
        mask[cells[:, 1] - corner[1], cells[:, 0] - corner[0]] = True
        return _Covered(np.packbits(mask, axis=1), cols, corner)

    def centers(self, square: float) -> FloatArray:
        """Return (n, 2) centers of the squares."""
        mask = np.unpackbits(self.bits, axis=1, count=self.cols)
        cells = np.argwhere(mask)[:, ::-1] + self.corner
        return np.asarray((cells + 0.5) * square, dtype=np.float64)

    def corners(self, square: float) -> FloatArray:
        """Return (4, 2) corners of the box around all squares."""
        (x0, y0), (rows, cols) = self.corner, (len(self.bits), self.cols)
        box = ((x0, y0), (x0 + cols, y0), (x0, y0 + rows), (x0 + cols, y0 + rows))
        return np.asarray(box, dtype=np.float64) * square


class Trimmer:
    """Area that each finished submap covers, in the submap's own frame."""

    def __init__(self, config: TrimmingConfig) -> None:
        self._config = config
        self._square = config.cell / 2
        self._covered: dict[int, _Covered] = {}
        self._trimmed_at = 0
        self._finished = 0

    @property
    def nbytes(self) -> int:
        """Memory of the areas."""
        return sum(covered.bits.nbytes for covered in self._covered.values())

    def add_finished_submap(self, index: int, submap: Submap) -> None:
        """Record the area of a finished submap."""
        self._finished += 1
        self._covered[index] = _Covered.by(submap.pose.inverse().apply(submap.known_points), self._square)

    def trimming_due(self) -> bool:
        """Whether there are enough new submaps to trim again."""
        return self._finished - self._trimmed_at >= self._config.min_added_submaps_count

    def pop_redundant(self, poses: Sequence[Pose2]) -> list[int]:
        """Return the redundant finished submaps, and drop their areas.

        Args:
            poses: `T_map_submap` of all submaps.
        """
        c, self._trimmed_at = self._config, self._finished
        corners = [poses[i].apply(covered.corners(self._square)) for i, covered in self._covered.items()]
        low, high = (np.floor(f(np.concatenate(corners), axis=0) / c.cell) for f in (np.min, np.max))
        count = np.zeros((high - low).astype(np.int64)[::-1] + 1, np.int16)
        redundant = []
        for index in sorted(self._covered, reverse=True):
            points = poses[index].apply(self._covered[index].centers(self._square))
            cells = (np.floor(points / c.cell) - low).astype(np.int64)
            mine = np.zeros(count.shape, np.bool_)
            mine[cells[:, 1], cells[:, 0]] = True
            fresh = np.count_nonzero(mine & (count < c.fresh_submaps_count))
            if fresh * c.cell**2 < c.min_covered_area:
                redundant.append(index)
                del self._covered[index]
            else:
                count += mine
        return redundant
