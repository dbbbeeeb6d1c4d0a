"""Localization: the pose of a robot in a known map that does not change.

Hess et al. 2016 with the known map instead of submaps: branch and bound over the whole map finds the robot,
then each scan is matched from the pose by dead reckoning. The search is ambiguous if another pose fits about
as well; it is repeated when the robot has moved on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter

from lirs_wct.errors import ConfigError
from lirs_wct.formats.map_server import read_map
from lirs_wct.geometry import FloatArray, Imu, LaserScan, OccupancyGrid, Pose2, Trajectory
from slam_baselines.cartographer.branch_and_bound import BoundGrids, Exclusion, SearchWindow, branch_and_bound
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.dead_reckoning import DeadReckoning, PoseEstimate, view_range
from slam_baselines.leveling import LeveledScan, ScanLeveler, voxel_filter
from slam_baselines.mapper import MapperStats, PlanarMapper
from slam_baselines.monitors import TrackingMonitor
from slam_baselines.occupancy_map import MapPyramid, OccupancyMap, UpdateConfig
from slam_baselines.registration import Match, Registration, ScanMatcher

DEPTH = 6
"""Number of times that four cells become one in the search."""
COARSE = 0.1
"""The search is made on the first level of at least this resolution, meters."""


@dataclass(frozen=True)
class KnownMap:
    """Known map on three levels for matching, and bounds for the search in it.

    The center (2,) is the middle of the map, and the reach half its longer side, meters.
    """

    grid: OccupancyGrid
    pyramid: MapPyramid
    bounds: BoundGrids
    center: tuple[float, float]
    reach: float

    @staticmethod
    def load(source: OccupancyGrid | str | Path) -> KnownMap:
        """Take a grid, or read a map YAML; either must have a wall."""
        grid = source if isinstance(source, OccupancyGrid) else read_map(Path(source))
        if not grid.occupied.any():
            name = "the known map" if isinstance(source, OccupancyGrid) else str(source)
            raise ConfigError(f"{name}: localization needs walls, no cell is occupied")
        sizes = [grid.resolution * 2**k for k in range(3)]
        search = next((size for size in sizes if size >= COARSE), sizes[-1])
        height, width = (n * grid.resolution for n in grid.shape)
        x, y = grid.origin.apply((width / 2, height / 2)).tolist()
        reach = math.hypot(width, height) / 2 if grid.origin.yaw else max(width, height) / 2
        pyramid = MapPyramid(tuple(_level(grid, size) for size in sizes))
        coarse = _level(grid, search)
        # Neighbors of walls get half their value, since the search's steps are that coarse.
        value = coarse.layers.value
        np.maximum(value, maximum_filter(value, 3) // 2, out=value)
        bounds = BoundGrids.of(coarse.grid, DEPTH)
        return KnownMap(grid, pyramid, bounds, (x, y), reach)

    @property
    def nbytes(self) -> int:
        """Memory of all levels."""
        return sum(level.grid.nbytes for level in self.pyramid.maps) + self.bounds.nbytes


def _level(grid: OccupancyGrid, resolution: float) -> OccupancyMap:
    """Resample the grid on a lattice of its frame; walls win."""
    level, limit = OccupancyMap(resolution), UpdateConfig().steps[2]
    rows, cols = grid.shape
    corners = grid.origin.apply(np.array(((0, 0), (cols, 0), (0, rows), (cols, rows))) * grid.resolution)
    level.grid.ensure(*corners.min(axis=0), *corners.max(axis=0))
    for mask, value in ((grid.free, -limit), (grid.occupied, limit)):
        points = grid.centers(np.argwhere(mask))
        cells = np.floor(points[:, ::-1] / resolution).astype(np.int64) - (level.grid.row0, level.grid.col0)
        level.grid.layers["log_odds"][cells[:, 0], cells[:, 1]] = value
    level._take_over()
    level.take_over_log_odds()
    return level


class CartographerLocalizer(PlanarMapper):
    """Localizer in a known map; `T_map_base` is in the frame of that map."""

    name = "cartographer"

    def __init__(self, config: CartographerConfig, known: KnownMap) -> None:
        """Begin at the configured start; None: anywhere in the map."""
        super().__init__()
        self.config = c = config
        self._known = known
        self._refiner = ScanMatcher(exact=True)
        self._registration = Registration(c, self._refiner)
        self._reckoning = DeadReckoning(c)
        self._leveler = ScanLeveler(c.clear_range, c.max_range)
        meters, radians = c.start_deviation
        self._start_covariance = np.diag((meters**2, meters**2, radians**2))
        self._anchored = c.start is not None
        self.lost = not self._anchored
        self._estimate = PoseEstimate(c.start or Pose2(), self._start_covariance)
        self._tracking = TrackingMonitor(c, map_given=True)
        self._searched: tuple[float, float] | None = None
        self._distance_traveled = 0.0
        # Before the first fix, poses are in the odometry's frame.
        self._track: dict[float, Pose2] = {}
        self._matched = self._searches = self._ambiguous = 0

    @property
    def known_map(self) -> OccupancyGrid:
        """The known map as it was given."""
        return self._known.grid

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to the map, or search for an unknown pose; return `T_map_base`.

        While `lost`, this is dead reckoning from the last known pose, at first from the map's origin.
        """
        level = self._leveler.level(scan, imu)
        last, before = self._estimate, self._estimate.pose
        self._estimate = self._reckoning.predict(self._estimate, odometry, imu, scan.stamp)
        if self.lost and self._search_due(scan.stamp):
            self._search_map(level)
        if not self.lost:
            self._estimate, match = self._registration.register(
                self._known.pyramid, level.hits, None, self._estimate, last
            )
            self._matched += match is not None
            self._tracking.observe(*((None, 1.0) if match is None else (match.score, match.known)))
            self.lost = self._tracking.lost
        self._distance_traveled += before.distance(self._estimate.pose)
        self._track[scan.stamp] = self._estimate.pose
        if self._anchored:
            wall = self._known.grid.resolution**2 / 12  # a wall lies anywhere in its cell
            floor = wall * np.diag((1.0, 1.0, view_range(level.hits) ** -2))
            self.covariance = self._estimate.covariance + floor
        return self._estimate.pose

    def map(self) -> OccupancyGrid:
        """Return the known map as it was given."""
        return self._known.grid

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan; odometry extends the first fix backward."""
        stamps = sorted(self._track)
        return Trajectory.from_poses(stamps, [self._track[t] for t in stamps])

    def counts(self) -> MapperStats:
        """Return used and skipped scans, memory and other counts."""
        return MapperStats(
            used=self._matched,
            skipped={"not matched": self.received - self._matched},
            memory=self._known.nbytes,
            counts={
                "global_searches": self._searches,
                "global_searches_ambiguous": self._ambiguous,
                "searches": self._registration.searches,
            },
        )

    def _search_due(self, stamp: float) -> bool:
        """Whether the robot has moved, or time has passed, enough since the last search."""
        c, last = self.config, self._searched
        return (
            last is None
            or self._distance_traveled - last[0] >= c.localization_distance
            or stamp - last[1] >= c.localization_interval
        )

    def _search_map(self, scan: LeveledScan) -> None:
        """Search the whole map; accept the best pose unless it is ambiguous."""
        c, known = self.config, self._known
        sparse = voxel_filter(scan.hits, known.bounds.resolution, c.localization_max_points)
        if len(sparse) < c.localization_min_points:
            return
        self._searches += 1
        self._searched = self._distance_traveled, scan.stamp
        start, window = np.array((*known.center, 0.0)), SearchWindow(known.reach, math.pi)
        nodes = c.localization_search_nodes
        found = branch_and_bound(known.bounds, sparse, start, window, c.localization_min_score, nodes)
        if found.score < 0:
            return
        least, excluded = c.ambiguity_ratio * found.score, Exclusion(found.pose, c.localization_separation)
        other = branch_and_bound(known.bounds, sparse, start, window, least, nodes, excluded)
        best, second = self._refine(scan, found.pose), None
        if other.score >= 0:
            best, second = sorted((best, self._refine(scan, other.pose)), key=lambda match: -match.score)
        alike = second is not None and second.score >= c.ambiguity_ratio * best.score
        if alike or not (found.complete and other.complete):
            self._ambiguous += 1
            return
        pose = Pose2(*best.pose.tolist())
        if not self._anchored:
            T_map_before = pose @ self._estimate.pose.inverse()
            self._track = {stamp: T_map_before @ before for stamp, before in self._track.items()}
            self._anchored = True
        self._estimate, self.lost = PoseEstimate(pose, self._start_covariance), False
        self._tracking = TrackingMonitor(c, map_given=True)

    def _refine(self, scan: LeveledScan, pose: FloatArray) -> Match:
        """Match the scan on the finest level from a pose of the search."""
        prior = PoseEstimate(Pose2(*pose.tolist()), self._start_covariance)
        return self._refiner.match(self._known.pyramid, scan.hits, None, prior, levels=3)
