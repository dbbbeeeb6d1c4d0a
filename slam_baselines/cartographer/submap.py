"""Submaps: pieces of the map, each drawn from a stretch of scans and rigid from then on.

Hess et al. 2016, "Real-time loop closure in 2D LIDAR SLAM", section IV: a scan enters two submaps, the
older of which is matched against; it has seen enough to match well, and when it is finished the
younger has, too.
"""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import SubmapConfig
from slam_baselines.mapping.occupancy_map import UNKNOWN, OccupancyMap, bounding_box
from slam_baselines.mapping.pyramid import MapPyramid
from slam_baselines.matching.branch_and_bound import BoundGrids
from slam_baselines.scan.leveling import ScanPoints


class Submap:
    """A small map in the local frame.

    Attributes:
        pose: `T_local_submap`, the pose of its first scan.
        nodes: indices of the scans in it.
        finished: whether no more scans will enter it.
        pyramid: occupancy, finest level first, in the local frame.
    """

    def __init__(self, config: SubmapConfig, pose: Pose2) -> None:
        self.pose = pose
        self.nodes: list[int] = []
        self.finished = False
        self._config = config
        self._wall_slope = 0
        self._bounds: BoundGrids | None = None
        sizes = [config.resolution * 2**level for level in range(config.levels)]
        self.pyramid = MapPyramid(tuple(OccupancyMap(size, config.update) for size in sizes))

    def drop_grids(self) -> None:
        """Drop what was drawn; pose and nodes stay."""
        empty = (OccupancyMap(level.resolution) for level in self.pyramid.maps)
        self.pyramid, self._bounds = MapPyramid(tuple(empty)), None

    @property
    def known_points(self) -> FloatArray:
        """(n, 2) centers of the cells of the coarsest level that beams came to, in the local frame."""
        grid = self.pyramid.maps[-1].grid
        cells = np.argwhere(grid.layers["log_odds"] != UNKNOWN)[:, ::-1] + (grid.col0, grid.row0)
        return np.asarray((cells + 0.5) * grid.resolution, dtype=np.float64)

    def draw_range_data(self, node: int, scan: ScanPoints, min_slopes: ByteArray, wall_slope: int) -> None:
        """Draw a scan, given in the local frame (see OccupancyMap.update)."""
        self.set_wall_slope(wall_slope)
        self.nodes.append(node)
        box = bounding_box(scan)
        grew = [level.update(scan, min_slopes, wall_slope, box) for level in self.pyramid.maps]
        if any(grew):
            self.pyramid.refresh()

    def set_wall_slope(self, wall_slope: int) -> None:
        """Let matchers see as walls only what has a minimum slope of `wall_slope`."""
        if wall_slope == self._wall_slope:
            return
        self._wall_slope, self._bounds = wall_slope, None
        for level in self.pyramid.maps:
            level.revalue(wall_slope)

    def min_slope(self, points: FloatArray) -> ByteArray:
        """Return (n,) the minimum slopes of the cells under points (n, 2 or more) of the local frame."""
        return self.pyramid.maps[-1].min_slope(points)

    @property
    def bounds(self) -> BoundGrids:
        """Upper bounds for the search for loops; computed when first needed after the submap finished."""
        if self._bounds is None:
            level = self.pyramid.maps[self._config.search_level]
            self._bounds = BoundGrids.of(level.grid, self._config.branch_and_bound_depth)
        return self._bounds

    @property
    def nbytes(self) -> int:
        """Memory of its grids."""
        grids = sum(level.grid.nbytes for level in self.pyramid.maps)
        return grids + (0 if self._bounds is None else self._bounds.nbytes)


class Submaps:
    """All submaps; the last two are being drawn."""

    def __init__(self, config: SubmapConfig) -> None:
        self._config = config
        self.all: list[Submap] = []

    @property
    def matching_submap(self) -> Submap:
        """The submap that scans are matched against."""
        return self.all[self.active[0]]

    @property
    def active(self) -> range:
        """Indices of the submaps that are being drawn, the older first."""
        first = len(self.all)
        while first > 0 and not self.all[first - 1].finished:
            first -= 1
        return range(first, len(self.all))

    def insert_range_data(
        self, node: int, pose: Pose2, scan: ScanPoints, min_slopes: ByteArray, wall_slope: int
    ) -> range:
        """Draw a scan taken at `pose`; return the submaps it entered."""
        if not self.all or len(self.all[-1].nodes) >= self._config.num_range_data:
            self.all.append(Submap(self._config, pose))
        entered = self.active
        for i in entered:
            self.all[i].draw_range_data(node, scan, min_slopes, wall_slope)
        older = self.all[entered[0]]
        older.finished = len(older.nodes) >= 2 * self._config.num_range_data
        return entered
