"""HectorSLAM's way: match each scan to the map by Gauss-Newton, then enter it.

Kohlbrecher et al. 2011, "A flexible and scalable SLAM system with full 3D motion estimation", written
from the paper. Beyond it: the odometry is a prior and not only a start, a poor match is searched for
in a wider window, and a scan that fits nowhere does not enter the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.grid import OccupancyGrid
from lirs_wct.pose import Pose2, wrap_angle
from lirs_wct.scan import Imu, LaserScan
from lirs_wct.trajectory import Trajectory
from slam_baselines.correlative import SearchConfig, search
from slam_baselines.levelling import LevelledScan, ScanLeveller
from slam_baselines.map_builder import BuilderConfig, MapBuilder
from slam_baselines.mapper import MapperStats, Stopwatch
from slam_baselines.odometry import MotionConfig, yaw_rate
from slam_baselines.scan_matching import Match, MatchConfig, ScanMatcher

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class HectorConfig(BuilderConfig):
    """Parameters of hector_mapping where they exist, and those of the parts.

    Attributes:
        match: Gauss-Newton.
        search: the wider search.
        motion: confidence in the odometry.
        laser_max_dist: hits farther away are not used, metres.
        laser_clear_dist: a beam without return is believed to be free up to here, metres.
        poor_score: below this mean occupancy at the ends of the beams the wider search begins.
        lost_score: below this a scan does not enter the map ...
        lost_after: ... and after so many of them in a row the mapper is lost.
        known_share: share of beams on known cells that a score needs to be believed.

    Raises:
        ConfigError: a score outside (0, 1), or iterations not given for each level.
    """

    match: MatchConfig = field(default_factory=MatchConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    laser_max_dist: float = math.inf
    laser_clear_dist: float = 0.0
    poor_score: float = 0.4
    lost_score: float = 0.25
    lost_after: int = 10
    known_share: float = 0.3
    least_beams: int = 15
    least_share: float = 0.02
    fresh_distance: float = 0.4

    def __post_init__(self) -> None:
        super(HectorConfig, self).__post_init__()
        if not 0 < self.lost_score <= self.poor_score < 1:
            raise ConfigError(
                f"scores must be 0 < lost_score <= poor_score < 1, got {self.lost_score} and {self.poor_score}"
            )
        if len(self.match.iterations) < self.map_multi_res_levels:
            raise ConfigError(
                f"iterations are needed for {self.map_multi_res_levels} levels, got {self.match.iterations}"
            )


class HectorMapper:
    """See the module."""

    def __init__(self, config: HectorConfig | None = None) -> None:
        self.config = config or HectorConfig()
        self._leveller = ScanLeveller(self.config.laser_clear_dist, self.config.laser_max_dist)
        self._builder = MapBuilder(self.config)
        self._matcher = ScanMatcher(self.config.match)
        self._pose = Pose2()
        self._covariance = np.zeros((3, 3))
        self._odometry: Pose2 | None = None
        self._stamp = 0.0
        self._rate: float | None = None
        self._poses: dict[float, Pose2] = {}
        self._received = self._matched = self._searches = self._lost_scans = self._poor_in_a_row = 0
        self._stopwatch = Stopwatch()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to the map, enter it, return `T_map_base`."""
        started = self._stopwatch.start()
        level = self._leveller.level(scan, imu)
        prior, covariance = self._predict(odometry, imu, scan.stamp)
        match = self.last = self._match(level, prior, covariance)
        self._builder.follow(level, self._pose)
        if self._judge(match) and self._builder.due(level, self._pose):
            self._builder.enter(level, self._pose)
        self._poses[scan.stamp] = self._pose
        self._stopwatch.stop(started)
        return self._pose

    def map(self) -> OccupancyGrid:
        """Return the finest level of the map."""
        return self._builder.map()

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan, by stamp."""
        stamps = sorted(self._poses)
        return Trajectory.from_poses(stamps, [self._poses[t] for t in stamps])

    @property
    def lost(self) -> bool:
        """Whether so many scans in a row fit nowhere that the pose is not to be believed."""
        return self._poor_in_a_row >= self.config.lost_after

    @property
    def stats(self) -> MapperStats:
        """What was done so far."""
        return MapperStats(
            received=self._received,
            used=self._matched,
            lost=self._lost_scans,
            memory=self._builder.memory,
            counts={"map_updates": self._builder.updates, "searches": self._searches},
            **self._stopwatch.summary(),
        )

    def _predict(self, odometry: Pose2 | None, imu: Imu | None, stamp: float) -> tuple[Pose2, Array]:
        """Return the pose that the odometry expects, and its covariance."""
        before, self._odometry = self._odometry, odometry
        seconds, self._stamp = stamp - self._stamp, stamp
        rate, self._rate = self._rate, None if imu is None else yaw_rate(imu)
        self._received += 1
        if self._received == 1:
            return self._pose, self._covariance
        delta = None if before is None or odometry is None else before.inverse() @ odometry
        turned = None if rate is None or self._rate is None else (rate + self._rate) / 2 * seconds
        return self.config.motion.predict(self._pose, self._covariance, delta, seconds, turned)

    def _match(self, scan: LevelledScan, prior: Pose2, covariance: Array) -> Match | None:
        """Move the estimate to where the scan fits; to the prior, if there is nothing to fit."""
        self._before = self._pose
        self._pose, self._covariance = prior, covariance
        if len(scan.hits) == 0 or self._builder.updates == 0:
            return None
        pyramid, expected, information = self._builder.pyramid, prior.as_array(), np.linalg.inv(covariance)
        weights = self.lastw = self._builder.weights(scan, prior)
        moved = prior.distance(self._before) + 0.5 * abs(wrap_angle(prior.yaw - self._before.yaw))
        share = min(1.0, max(self.config.least_share, moved / self.config.fresh_distance))
        weights *= share
        levels = self._matcher.levels(pyramid, covariance)
        match = self._matcher.match(pyramid, scan.hits, weights, expected, information, levels)
        if match.beams < self.config.least_beams * share:
            return None
        if match.known >= self.config.known_share and match.score < self.config.poor_score:
            self._searches += 1
            start = search(pyramid.maps[-1].grid, scan.hits, weights, expected, self.config.search)
            wider = self._matcher.match(pyramid, scan.hits, weights, expected, information, len(pyramid.maps), start)
            match = max(match, wider, key=lambda m: m.score)
        x, y, yaw = match.pose.tolist()
        self._pose = Pose2(x, y, wrap_angle(yaw))
        self._covariance = np.linalg.inv(information + match.information)
        self._matched += 1
        return match

    def _judge(self, match: Match | None) -> bool:
        """Keep count of poor matches; return whether the scan may enter the map."""
        c = self.config
        fits = match is None or match.known < c.known_share or match.score >= c.lost_score
        self._poor_in_a_row = 0 if fits else self._poor_in_a_row + 1
        self._lost_scans += self.lost
        return fits
