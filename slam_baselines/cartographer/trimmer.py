"""Redundant submaps: those of places that have been seen often enough since.

A robot that drives the same path again and again sees nothing new; without trimming its memory would grow
with time and not with the area. After Cartographer's trimmer of overlapping submaps: of each place, the
freshest submaps are kept.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import TrimmingConfig
from slam_baselines.cartographer.submap import Submap


class Trimmer:
    """Area that each finished submap covers, in the submap's own frame."""

    def __init__(self, config: TrimmingConfig) -> None:
        self._config = config
        self._covered: dict[int, FloatArray] = {}
        self._trimmed_at = 0
        self._finished = 0

    def add_finished_submap(self, index: int, submap: Submap) -> None:
        """Record the area of a submap that no scan will enter any more."""
        self._finished += 1
        local = submap.pose.inverse().apply(submap.known_points)
        squares = np.unique(np.floor(local / (self._config.cell / 2)).astype(np.int64), axis=0)
        self._covered[index] = np.asarray((squares + 0.5) * (self._config.cell / 2), dtype=np.float64)

    def trimming_due(self) -> bool:
        """Whether there are enough new submaps to trim again."""
        return self._finished - self._trimmed_at >= self._config.min_added_submaps_count

    def pop_redundant(self, poses: Sequence[Pose2]) -> list[int]:
        """Return the redundant finished submaps, and forget their areas.

        Args:
            poses: `T_map_submap` of all submaps.
        """
        c, self._trimmed_at = self._config, self._finished
        keys = {i: self._cells(self._covered[i], poses[i]) for i in sorted(self._covered, reverse=True)}
        cells, at = np.unique(np.concatenate(list(keys.values())), return_inverse=True)
        count, first, redundant = np.zeros(len(cells), np.int64), 0, []
        for index, own in keys.items():
            mine = at[first : first + len(own)]
            first += len(own)
            if (count[mine] < c.fresh_submaps_count).sum() * c.cell**2 < c.min_covered_area:
                redundant.append(index)
                del self._covered[index]
            else:
                count[mine] += 1
        return redundant

    def _cells(self, local: FloatArray, pose: Pose2) -> IntArray:
        """Return the keys of the cells that points of a submap lie in."""
        cells = np.floor(pose.apply(local) / self._config.cell).astype(np.int64)
        return np.unique(cells[:, 0] * (1 << 32) + cells[:, 1])
