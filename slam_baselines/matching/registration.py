"""A scan laid into the map: from the estimate to expect to the estimate that fits.

Gauss-Newton from the expected pose first; a wider, correlative search where that fits poorly.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, wrap_angle
from slam_baselines.common.linalg import invert3
from slam_baselines.matching.correlative import SearchConfig, search
from slam_baselines.matching.gauss_newton import MapPyramid, Match, MatchConfig, ScanMatcher
from slam_baselines.motion.dead_reckoning import PoseEstimate


@dataclass(frozen=True, kw_only=True)
class RegistrationConfig:
    """When a fit is believed, and when it is searched for.

    Attributes:
        match: Gauss-Newton.
        search: the wider search.
        search_threshold: mean occupancy at the ends of the beams below which the wider search begins.
        sure_score: the same from which on a fit on uneven ground says how good dead reckoning was.
        known_ratio: share of beams on known cells that a score needs to be believed.
        min_beams: fewer beams on known cells than this say nothing.
        min_walls: on uneven ground, where what passes for a wall may be ground, fewer walls say nothing.
        mahalanobis_gate: on uneven ground, a pose farther than so many standard deviations from dead
            reckoning is not believed, however well it fits.
        gain: the wider search must raise the score by this to be believed against the odometry.
        decorrelation_distance: scans closer together than this see the same cells with the same errors, so
            that each adds only its share of information, metres.
        min_share: ... but never less than this.

    Raises:
        ConfigError: a share or score outside (0, 1), or a distance that is not above 0.
    """

    match: MatchConfig = field(default_factory=MatchConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    search_threshold: float = 0.4
    sure_score: float = 0.6
    known_ratio: float = 0.3
    min_beams: int = 15
    min_walls: int = 40
    mahalanobis_gate: float = 4.0
    gain: float = 0.05
    decorrelation_distance: float = 0.4
    min_share: float = 0.02

    def __post_init__(self) -> None:
        for name in ("search_threshold", "sure_score", "known_ratio", "min_share"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name} must be within (0, 1), got {getattr(self, name)}")
        if not self.decorrelation_distance > 0:
            raise ConfigError(f"decorrelation_distance must be above 0 m, got {self.decorrelation_distance}")


class Registration:
    """Fits scans into a map.

    Attributes:
        searches: how often the wider search was needed.
    """

    def __init__(self, config: RegistrationConfig) -> None:
        self.config = config
        self.searches = 0
        self._matcher = ScanMatcher(config.match)

    def fit(
        self,
        pyramid: MapPyramid,
        hits: FloatArray,
        weights: FloatArray | None,
        expected: PoseEstimate,
        before: Pose2,
        earlier: Pose2 | None = None,
    ) -> tuple[PoseEstimate, Match | None]:
        """Return the estimate that fits, and the match; `expected` and None where nothing can be said.

        Args:
            pyramid: the map.
            hits: (n, 2 or more) ends of beams in the leveled base frame, metres.
            weights: (n,) 1 for walls, less for what is less steep, 0 for what may be ground; None on a
                floor, where every hit is a wall.
            expected: the estimate by dead reckoning.
            before: pose of the last fit.
            earlier: pose of the fit before that one; a robot of which the odometry says nothing sensible may
                simply have gone on as it went from there.
        """
        c, start = self.config, expected.pose
        moved = start.distance(before) + 0.5 * abs(wrap_angle(start.yaw - before.yaw))
        share = min(1.0, max(c.min_share, moved / c.decorrelation_distance))
        uneven, walls = weights is not None, len(hits) if weights is None else np.count_nonzero(weights)
        if walls < (c.min_walls if uneven else c.min_beams):
            return expected, None
        prior = start.as_array()
        match, covariance = self._matcher.fit(pyramid, hits, weights, share, prior, expected.covariance)
        if walls * match.known < c.min_beams:
            return expected, None
        if match.known >= c.known_ratio and match.score < c.search_threshold:
            wider, loose = self._search(pyramid, hits, weights, share, prior, _coasting(before, earlier))
            if uneven and max(match.score, wider.score) < c.search_threshold:
                # Nothing fits, near or far: dead reckoning errs less than a forced fit.
                return expected, match
            if uneven and not self._within_gate(wider, expected):
                return expected, match
            if wider.score > match.score + c.gain:
                match, covariance = wider, loose
        x, y, yaw = match.pose.tolist()
        return PoseEstimate(Pose2(x, y, wrap_angle(yaw)), covariance), match

    def _search(
        self,
        pyramid: MapPyramid,
        hits: FloatArray,
        weights: FloatArray | None,
        share: float,
        prior: FloatArray,
        coasting: FloatArray,
    ) -> tuple[Match, FloatArray]:
        """Fit from the best place in the wider window, and from where the robot would have coasted to."""
        self.searches += 1
        c = self.config.search
        linear, angular = c.linear_search_window**2, c.angular_search_window**2
        loose = np.diag((linear, linear, angular))
        found = search(
            pyramid.maps[-1].grid, hits, np.ones(len(hits)) if weights is None else weights, prior, c
        )
        fits = [
            self._matcher.fit(pyramid, hits, weights, share, prior, loose, start)
            for start in (found, coasting)
        ]
        return max(fits, key=lambda fit: fit[0].score)

    def _within_gate(self, found: Match, expected: PoseEstimate) -> bool:
        """Whether a pose lies where dead reckoning may have led."""
        off = found.pose - expected.pose.as_array()
        off[2] = wrap_angle(off[2])
        return bool(off @ invert3(expected.covariance) @ off <= self.config.mahalanobis_gate**2)


def _coasting(before: Pose2, earlier: Pose2 | None) -> FloatArray:
    """Return the (3,) pose that another step like the one from `earlier` to `before` leads to."""
    return (before if earlier is None else before @ (earlier.inverse() @ before)).as_array()
