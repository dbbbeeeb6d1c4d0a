"""Occupancy maps of growing cell size, for matching from coarse to fine."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray
from slam_baselines.mapping.occupancy_map import OccupancyMap


class Levels(NamedTuple):
    """Arrays of a pyramid for the matcher's kernels, finest level first.

    Attributes:
        values: (rows, cols) uint8 layer `value` of each level.
        frames: (levels, 3) lattice row and column of cell (0, 0), resolution in meters.
    """

    values: tuple[Any, ...]
    frames: FloatArray


class MapPyramid:
    """Occupancy maps of growing cell size, finest first.

    Attributes:
        maps: the levels.
        levels: their arrays.
    """

    def __init__(self, maps: tuple[OccupancyMap, ...]) -> None:
        self.maps = maps
        self.refresh()

    def refresh(self) -> None:
        """Take over the maps' arrays; needed whenever one of them grew."""
        self.levels = Levels(
            tuple(level.layers.value for level in self.maps), np.array([level.frame for level in self.maps])
        )
