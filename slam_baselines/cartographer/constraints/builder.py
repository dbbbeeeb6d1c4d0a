"""Loop closure: nodes found again in finished submaps.

Hess et al. 2016, section V-B: branch and bound for where a scan fits into a submap, then refinement
by Gauss-Newton on the interpolated map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, wrap_angle
from slam_baselines.cartographer.submap import Submap
from slam_baselines.common.se2 import inverted
from slam_baselines.matching.branch_and_bound import branch_and_bound
from slam_baselines.matching.gauss_newton import Match, MatchConfig, ScanMatcher


@dataclass(frozen=True, kw_only=True)
class ConstraintConfig:
    """Where loops are searched for and which are believed; names as in constraint_builder.

    Attributes:
        min_score: mean occupancy at the ends of the beams that a loop needs in the search; it is 0 where the
            submap knows nothing.
        min_refined_score: mean occupancy that it needs after refinement, where the submap knows something ...
        min_known: ... and the share of beams that end there.
        global_min_score: the same in the widest search: the more poses there are, the more fit by chance.
        linear_search_window: shifts at most up to this in x and in y, metres.
        angular_search_window: turns at most up to this, radians.
        linear_start: shifts up to this after no way at all, metres ...
        linear_drift: ... and so much more for each metre driven.
        angular_start: likewise of turns, radians ...
        angular_drift: ... and radians per metre.
        linear_refined: up to this window, refinement alone finds the pose, metres.
        rival: a pose found is not believed if another one has this share of its score ...
        apart: ... at least so far from it, metres.
        beams: at most so many beams are used to search, evenly spread in space.
        least_beams: fewer than this say nothing.
        spread: one beam for each square of this size, metres.
        bounded: a search is given up after so many nodes of its tree.
        match: refinement.
        loose: standard deviation of the search's result for the refinement, metres and radians.
        floor: standard deviation that a loop has at least, metres and radians: submaps are not perfect.

    Raises:
        ConfigError: a value that is not above 0, or scores not in order.
    """

    min_score: float = 0.4
    min_refined_score: float = 0.5
    min_known: float = 0.4
    global_min_score: float = 0.55
    linear_search_window: float = 5.0
    angular_search_window: float = math.radians(20.0)
    linear_start: float = 0.3
    linear_drift: float = 0.03
    angular_start: float = 0.05
    angular_drift: float = 0.003
    linear_refined: float = 0.6
    rival: float = 0.9
    apart: float = 0.5
    beams: int = 120
    least_beams: int = 20
    spread: float = 0.1
    bounded: int = 60000
    match: MatchConfig = field(default_factory=lambda: MatchConfig(iterations=(8, 5, 5)))
    loose: tuple[float, float] = (0.2, 0.05)
    floor: tuple[float, float] = (0.02, 0.003)

    def __post_init__(self) -> None:
        for name in set(self.__dataclass_fields__) - {"match", "loose", "floor"}:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the constraints must be above 0, got {getattr(self, name)}")
        if not self.min_score <= self.global_min_score <= 1:
            raise ConfigError(
                f"global_min_score must be at least min_score = {self.min_score} and at most 1, "
                f"got {self.global_min_score}"
            )


@dataclass(frozen=True, slots=True)
class Constraint:
    """A node's pose as seen from a submap.

    Attributes:
        submap: index.
        node: index.
        T_submap_node: measured.
        information: (3, 3) its inverse covariance, in the submap's axes.
        score: mean occupancy at the ends of the beams; 1 where it comes from local SLAM.
    """

    submap: int
    node: int
    T_submap_node: Pose2
    information: FloatArray
    score: float = 1.0


@dataclass
class SearchCounts:
    """What the searches came to."""

    searched: int = 0
    found: int = 0
    poor: int = 0
    given_up: int = 0
    ambiguous: int = 0


class ConstraintBuilder:
    """Finds scans in submaps.

    Attributes:
        counts: what became of the searches.
    """

    def __init__(self, config: ConstraintConfig) -> None:
        self.config = config
        self.counts = SearchCounts()
        self._matcher = ScanMatcher(config.match)
        metres, radians = config.floor
        self._floor = np.diag((metres**2, metres**2, radians**2))

    def search(
        self, submap: Submap, points: FloatArray, start: Pose2, way: float
    ) -> tuple[Pose2, FloatArray, float] | None:
        """Look for a scan in a submap, the wider the longer ago the robot was there.

        Args:
            submap: finished.
            points: (n, 2 or more) hits on walls in the levelled base frame, metres.
            start: expected pose of the base in the submap's local frame.
            way: driven since the robot was last tied to the submap, or will be next, metres.

        Returns:
            Pose of the base in the submap's local frame, its information there, and the score; None where the
            scan fits nowhere well.
        """
        self.counts.searched += 1
        sparse = spread(points, self.config.spread, self.config.beams)
        if len(sparse) < self.config.least_beams:
            self.counts.poor += 1
            return None
        match = self._fit(submap, points, sparse, start.as_array(), way)
        if match is None:
            return None
        self.counts.found += 1
        x, y, yaw = match.pose.tolist()
        information = inverted(inverted(match.information + 1e-3 * np.eye(3)) + self._floor)
        return Pose2(x, y, wrap_angle(yaw)), information, match.score * match.known

    def _fit(
        self, submap: Submap, points: FloatArray, sparse: FloatArray, start: FloatArray, way: float
    ) -> Match | None:
        """Fit from the expected pose, if that is well known; else from the best pose of a window."""
        c = self.config
        linear = min(c.linear_search_window, c.linear_start + c.linear_drift * way)
        angular = min(c.angular_search_window, c.angular_start + c.angular_drift * way)
        if linear > c.linear_refined:
            found = self._best(submap, sparse, start, linear, angular)
            if found is None:
                return None
            start, linear, angular = found, *c.loose
        loose = np.diag((linear**-2, linear**-2, angular**-2))
        match = self._matcher.match(
            submap.pyramid, points, np.ones(len(points)), start, loose, len(c.match.iterations)
        )
        if match.score < c.min_refined_score or match.known < c.min_known:
            self.counts.poor += 1
            return None
        return match

    def _best(
        self, submap: Submap, points: FloatArray, start: FloatArray, linear: float, angular: float
    ) -> FloatArray | None:
        """Search a window; None where nothing fits or, as along a corridor, two places fit equally well."""
        c = self.config
        least = c.min_score + (c.global_min_score - c.min_score) * linear / c.linear_search_window
        found = branch_and_bound(submap.bounds, points, start, linear, angular, least, c.bounded)
        self.counts.given_up += not found.complete
        if found.score < 0:
            self.counts.poor += 1
            return None
        rival = branch_and_bound(
            submap.bounds,
            points,
            start,
            linear,
            angular,
            c.rival * found.score,
            c.bounded,
            found.pose,
            c.apart,
        )
        if rival.score >= 0 or not rival.complete:
            self.counts.ambiguous += 1
            return None
        return found.pose


def spread(points: FloatArray, size: float, most: int) -> FloatArray:
    """Return at most `most` of the points, at first one for each square of the given size."""
    cells = np.floor(points[:, :2] / size).astype(np.int64)
    _, first = np.unique(cells[:, 0] * (1 << 20) + cells[:, 1], return_index=True)
    first.sort()
    stride = max(1, -(-len(first) // most))
    return np.asarray(points[first[::stride]], dtype=np.float64)
