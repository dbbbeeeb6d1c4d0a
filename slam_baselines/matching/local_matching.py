"""A scan laid into the submap in front: Gauss-Newton from where dead reckoning puts it, a search if need be.

Hess et al. 2016, section IV-C (ceres_scan_matcher and real_time_correlative_scan_matcher of the original):
the prediction is a prior, so that a direction in which the submap says nothing follows the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, wrap_angle
from slam_baselines.common.linalg import inverted
from slam_baselines.matching.correlative import SearchConfig, search
from slam_baselines.matching.gauss_newton import MapPyramid, Match, MatchConfig, ScanMatcher
from slam_baselines.motion.dead_reckoning import PoseEstimate


@dataclass(frozen=True, kw_only=True)
class LocalMatchingConfig:
    """When a fit is believed, and when it is searched for.

    Attributes:
        match: Gauss-Newton.
        search: the correlative search.
        search_threshold: mean occupancy at the ends of the beams below which the search begins.
        known_ratio: share of beams on known cells that a score needs to be believed.
        min_beams: fewer beams on known cells than this say nothing.
        decorrelation_distance: scans closer together than this see the same cells with the same errors, so
            that each adds only its share of information, metres.
        min_share: ... but never less than this.

    Raises:
        ConfigError: a share or score outside (0, 1), or a distance that is not above 0.
    """

    match: MatchConfig = field(default_factory=lambda: MatchConfig(iterations=(5, 3, 3), sigma=0.3))
    search: SearchConfig = field(default_factory=SearchConfig)
    search_threshold: float = 0.4
    known_ratio: float = 0.3
    min_beams: int = 15
    decorrelation_distance: float = 0.4
    min_share: float = 0.02

    def __post_init__(self) -> None:
        for name in ("search_threshold", "known_ratio", "min_share"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name} must be within (0, 1), got {getattr(self, name)}")
        if not self.decorrelation_distance > 0:
            raise ConfigError(f"decorrelation_distance must be above 0 m, got {self.decorrelation_distance}")


class LocalMatcher:
    """Fits scans into a submap.

    Attributes:
        searches: how often the search was needed.
    """

    def __init__(self, config: LocalMatchingConfig) -> None:
        self.config = config
        self.searches = 0
        self._matcher = ScanMatcher(config.match)

    def fit(
        self,
        pyramid: MapPyramid,
        hits: FloatArray,
        weights: FloatArray,
        expected: PoseEstimate,
        before: Pose2,
    ) -> tuple[PoseEstimate, Match | None]:
        """Return the estimate that fits, and the match; `expected` and None where nothing can be said.

        Args:
            pyramid: the submap.
            hits: (n, 2 or more) ends of beams in the leveled base frame, metres.
            weights: (n,) 1 for walls, 0 for what may be ground.
            expected: the estimate by dead reckoning.
            before: pose of the last fit.
        """
        c, start = self.config, expected.pose
        if weights.sum() < c.min_beams:
            return expected, None
        moved = start.distance(before) + 0.5 * abs(wrap_angle(start.yaw - before.yaw))
        share = min(1.0, max(c.min_share, moved / c.decorrelation_distance))
        prior, information = start.as_array(), inverted(expected.covariance)
        levels = self._matcher.levels(pyramid, expected.covariance)
        fresh = weights * share
        match = self._matcher.match(pyramid, hits, fresh, prior, information, levels)
        if match.beams < c.min_beams * share:
            return expected, None
        if match.known >= c.known_ratio and match.score < c.search_threshold:
            self.searches += 1
            found = search(pyramid.maps[-1].grid, hits, weights, prior, c.search)
            every = len(pyramid.maps)
            wider = self._matcher.match(pyramid, hits, fresh, prior, information, every, found)
            match = max(match, wider, key=lambda m: m.score)
        x, y, yaw = match.pose.tolist()
        return PoseEstimate(Pose2(x, y, wrap_angle(yaw)), inverted(information + match.information)), match
