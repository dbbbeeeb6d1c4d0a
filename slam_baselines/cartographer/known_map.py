"""A map that is given, laid out for matching and for the search over all of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from lirs_wct.arrays import BoolArray
from lirs_wct.errors import ConfigError
from lirs_wct.formats.map_server import read_map
from lirs_wct.geometry.grid import OccupancyGrid
from slam_baselines.mapping.occupancy_map import OccupancyMap, UpdateConfig
from slam_baselines.mapping.pyramid import MapPyramid
from slam_baselines.matching.branch_and_bound import BoundGrids

DEPTH = 6
"""How often four cells become one in the search."""
COARSE = 0.1
"""The search is made on the first level of at least this resolution, metres."""


@dataclass(frozen=True)
class KnownMap:
    """A given map.

    Attributes:
        grid: as it was given; never changed.
        pyramid: the same on three levels, for the matcher.
        bounds: for branch and bound.
        centre: (2,) middle of the map, metres.
        reach: half its longer side, metres.
    """

    grid: OccupancyGrid
    pyramid: MapPyramid
    bounds: BoundGrids
    centre: tuple[float, float]
    reach: float

    @staticmethod
    def of(source: OccupancyGrid | str | Path) -> KnownMap:
        """Take a grid, or read a map YAML.

        Raises:
            SourceError: the file cannot be used.
            ConfigError: there is no wall in the map.
        """
        grid = source if isinstance(source, OccupancyGrid) else read_map(Path(source))
        if not grid.occupied.any():
            name = "the known map" if isinstance(source, OccupancyGrid) else str(source)
            raise ConfigError(f"{name}: localisation needs walls, no cell is occupied")
        sizes = [grid.resolution * 2**k for k in range(3)]
        search = next((size for size in sizes if size >= COARSE), sizes[-1])
        height, width = (n * grid.resolution for n in grid.shape)
        x, y = grid.origin.apply((width / 2, height / 2)).tolist()
        reach = math.hypot(width, height) / 2 if grid.origin.yaw else max(width, height) / 2
        pyramid = MapPyramid(tuple(_level(grid, size) for size in sizes))
        bounds = BoundGrids.of(_softened(_level(grid, search)).grid, DEPTH)
        return KnownMap(grid, pyramid, bounds, (x, y), reach)

    @property
    def nbytes(self) -> int:
        """Memory of all levels."""
        return sum(level.grid.nbytes for level in self.pyramid.maps) + self.bounds.nbytes


def _level(grid: OccupancyGrid, resolution: float) -> OccupancyMap:
    """Return the grid on a lattice of its frame; a cell that holds a wall is wall."""
    level, limit = OccupancyMap(resolution), UpdateConfig().steps[2]
    rows, cols = grid.shape
    corners = grid.origin.apply(np.array(((0, 0), (cols, 0), (0, rows), (cols, rows))) * grid.resolution)
    level.grid.ensure(*corners.min(axis=0), *corners.max(axis=0))
    steps = level.grid.layers["log_odds"]
    _lay(grid, grid.free, -limit, level, steps)
    _lay(grid, grid.occupied, limit, level, steps)
    level._take_over()
    level.revalue(0)
    return level


def _lay(
    grid: OccupancyGrid, mask: BoolArray, value: int, level: OccupancyMap, steps: NDArray[np.int8]
) -> None:
    points = grid.centres(np.argwhere(mask))
    cells = np.floor(points[:, ::-1] / level.resolution).astype(np.int64)
    steps[cells[:, 0] - level.grid.row0, cells[:, 1] - level.grid.col0] = value


def _softened(level: OccupancyMap) -> OccupancyMap:
    """Let a miss by one cell count half: turns and shifts of the search are as coarse as that."""
    value = level.layers.value
    np.maximum(value, maximum_filter(value, 3) // 2, out=value)
    return level
