"""Which submaps are no longer needed: those of places that have been seen often enough since.

A robot that drives the same way again and again sees nothing new; without trimming its memory would grow
with time and not with the area. After Cartographer's trimmer of overlapping submaps: of each place, the
freshest submaps are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.submap import Submap


@dataclass(frozen=True, kw_only=True)
class TrimmingConfig:
    """Which submaps are kept; names as in Cartographer's overlapping_submaps_trimmer_2d.

    Attributes:
        fresh_submaps_count: of each place, so many of the newest finished submaps are kept.
        min_covered_area: a submap is kept for no less area than this, square metres.
        min_added_submaps_count: it is asked whenever so many more submaps are finished.
        cell: edge of what counts as one place, metres.

    Raises:
        ConfigError: a value that is not above 0.
    """

    fresh_submaps_count: int = 3
    min_covered_area: float = 4.0
    min_added_submaps_count: int = 5
    cell: float = 0.5

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the trimming must be above 0, got {getattr(self, name)}")


class Trimmer:
    """Remembers what each finished submap covers, in the submap's own frame."""

    def __init__(self, config: TrimmingConfig) -> None:
        self._config = config
        self._covered: dict[int, FloatArray] = {}
        self._asked_at = 0
        self._finished = 0

    def finished(self, index: int, submap: Submap) -> None:
        """Take note of a submap that no scan will enter any more."""
        self._finished += 1
        local = submap.pose.inverse().apply(submap.known_points)
        squares = np.unique(np.floor(local / (self._config.cell / 2)).astype(np.int64), axis=0)
        self._covered[index] = np.asarray((squares + 0.5) * (self._config.cell / 2), dtype=np.float64)

    def due(self) -> bool:
        """Whether there are enough new submaps to ask again."""
        return self._finished - self._asked_at >= self._config.min_added_submaps_count

    def needless(self, poses: Sequence[Pose2]) -> list[int]:
        """Return the finished submaps that are needed no more, and forget them.

        Args:
            poses: `T_map_submap` of all submaps.
        """
        c, self._asked_at = self._config, self._finished
        keys = {i: self._places(self._covered[i], poses[i]) for i in sorted(self._covered, reverse=True)}
        places, at = np.unique(np.concatenate(list(keys.values())), return_inverse=True)
        count, first, needless = np.zeros(len(places), np.int64), 0, []
        for index, own in keys.items():
            mine = at[first : first + len(own)]
            first += len(own)
            if (count[mine] < c.fresh_submaps_count).sum() * c.cell**2 < c.min_covered_area:
                needless.append(index)
                del self._covered[index]
            else:
                count[mine] += 1
        return needless

    def _places(self, local: FloatArray, pose: Pose2) -> IntArray:
        """Return the keys of the places that points of a submap lie in."""
        cells = np.floor(pose.apply(local) / self._config.cell).astype(np.int64)
        return np.unique(cells[:, 0] * (1 << 32) + cells[:, 1])
