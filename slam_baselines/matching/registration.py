"""Scan registration: update of the predicted estimate by matching the scan to the map.

Gauss-Newton starts from the expected pose, which is a prior, so that a direction which the map does not
constrain follows the odometry. A poor fit leads to a wider, correlative search (Hess et al. 2016, section
IV-C: ceres_scan_matcher and real_time_correlative_scan_matcher).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.field_validators import require_above, require_at_least, require_within
from lirs_wct.geometry import Pose2, wrap_angle
from slam_baselines.linalg import invert3
from slam_baselines.mapping.occupancy_map import MapPyramid
from slam_baselines.matching.correlative import SearchConfig, correlative_search
from slam_baselines.matching.gauss_newton import Match, MatchConfig, Prior, ScanMatcher
from slam_baselines.motion.dead_reckoning import PoseEstimate


@dataclass(frozen=True, kw_only=True)
class RegistrationConfig:
    """Thresholds of the wider search, and acceptance of matches.

    Attributes:
        match: Gauss-Newton.
        search: the wider search.
        search_threshold: mean occupancy at the ends of the beams below which the wider search begins.
        min_gain: gain of the score that the wider search needs to be preferred.
        search_prior: whether the fit after the wider search keeps the prior of dead reckoning; else its prior
            is as wide as the window.
        coasting: whether the wider search also starts at the pose after repeating the last motion.
        known_ratio: share of beams on known cells that a score needs to count.
        min_beams: fewest beams on known cells for a match.
        min_walls: fewest hits on walls for a match on uneven ground, where a wall may be ground.
        reject_poor: whether a match on uneven ground is rejected where even the wider search stays below the
            search threshold: dead reckoning errs less than a forced fit.
        mahalanobis_gate: largest Mahalanobis distance from dead reckoning at which the wider search is
            accepted on uneven ground.
        decorrelation_distance: distance between scans below which they see the same cells with the same
            errors, so that each adds only its share of information, meters.
        min_information_share: smallest share of information that a scan adds.

    Raises:
        ConfigError: a ratio, share or threshold outside (0, 1), or a distance that is not above 0.
    """

    match: MatchConfig = field(default_factory=MatchConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    search_threshold: float = 0.4
    min_gain: float = 0.05
    search_prior: bool = False
    coasting: bool = True
    known_ratio: float = 0.3
    min_beams: int = 15
    min_walls: int = 40
    reject_poor: bool = True
    mahalanobis_gate: float = 4.0
    decorrelation_distance: float = 0.4
    min_information_share: float = 0.02

    def __post_init__(self) -> None:
        ratios = ("search_threshold", "known_ratio", "min_information_share")
        require_within(self, "(0, 1)", *ratios, of="the registration")
        require_above(self, 0, "decorrelation_distance", "mahalanobis_gate", of="the registration")
        require_at_least(self, 0, "min_gain", of="the registration")
        require_at_least(self, 1, "min_beams", "min_walls", of="the registration")


class Registration:
    """Registers scans in a map.

    Attributes:
        searches: number of wider searches.
    """

    def __init__(self, config: RegistrationConfig) -> None:
        self.config = config
        self.searches = 0
        self._matcher = ScanMatcher(config.match)

    def register(
        self,
        pyramid: MapPyramid,
        hits: FloatArray,
        weights: FloatArray | None,
        expected: PoseEstimate,
        before: Pose2,
        earlier: Pose2 | None = None,
    ) -> tuple[PoseEstimate, Match | None]:
        """Return the estimate and its match; `expected` and None without enough walls.

        Args:
            pyramid: the map.
            hits: (n, 2 or more) ends of beams in the leveled base frame, meters.
            weights: (n,) 1 for walls, less for slopes, 0 for possible ground; None on flat ground, where
                every hit is a wall.
            expected: the estimate by dead reckoning.
            before: pose of the last registration.
            earlier: pose of the registration before that one, for coasting.
        """
        c = self.config
        uneven, walls = weights is not None, len(hits) if weights is None else np.count_nonzero(weights)
        if walls < (c.min_walls if uneven else c.min_beams):
            return expected, None
        share = self._information_share(expected.pose, before)
        prior = Prior(expected.pose.as_array(), expected.covariance)
        match = self._matcher.match(pyramid, hits, weights, prior, information_share=share)
        if match.known < c.min_beams / walls:
            return expected, None
        if match.known >= c.known_ratio and match.score < c.search_threshold:
            wider = self._search(pyramid, hits, weights, share, prior, _coasting(before, earlier))
            if uneven and self._is_rejected(match, wider, prior):
                return expected, match
            if wider.score > match.score + c.min_gain:
                match = wider
        x, y, yaw = match.pose.tolist()
        return PoseEstimate(Pose2(x, y, wrap_angle(yaw)), match.covariance), match

    def _information_share(self, pose: Pose2, before: Pose2) -> float:
        """Return the share of information that a scan at `pose` adds to that at `before`."""
        c = self.config
        moved = pose.distance(before) + 0.5 * abs(wrap_angle(pose.yaw - before.yaw))
        return min(1.0, max(c.min_information_share, moved / c.decorrelation_distance))

    def _search(
        self,
        pyramid: MapPyramid,
        hits: FloatArray,
        weights: FloatArray | None,
        share: float,
        prior: Prior,
        coasting: FloatArray,
    ) -> Match:
        """Match from the best pose of the wider window, and from the coasting pose."""
        self.searches += 1
        c = self.config
        points_weights = np.ones(len(hits)) if weights is None else weights
        start = correlative_search(pyramid.maps[-1].grid, hits, points_weights, prior.pose, c.search)
        if not c.search_prior:
            linear, angular = c.search.linear_search_window**2, c.search.angular_search_window**2
            prior = Prior(prior.pose, np.diag((linear, linear, angular)))
        matches = [
            self._matcher.match(
                pyramid, hits, weights, prior, start=first, levels=len(pyramid.maps), information_share=share
            )
            for first in ((start, coasting) if c.coasting else (start,))
        ]
        return max(matches, key=lambda match: match.score)

    def _is_rejected(self, match: Match, wider: Match, prior: Prior) -> bool:
        """Return whether no pose fits, or only one that dead reckoning excludes."""
        c = self.config
        if c.reject_poor and max(match.score, wider.score) < c.search_threshold:
            return True
        off = wider.pose - prior.pose
        off[2] = wrap_angle(off[2])
        return not off @ invert3(prior.covariance) @ off <= c.mahalanobis_gate**2


def _coasting(before: Pose2, earlier: Pose2 | None) -> FloatArray:
    """Return the (3,) pose after repeating the step from `earlier` to `before`."""
    return (before if earlier is None else before @ (earlier.inverse() @ before)).as_array()
