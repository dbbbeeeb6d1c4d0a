"""Loop constraints: nodes matched to finished submaps.

Hess et al. 2016, section V-B: branch and bound over the poses of a scan in a submap, then refinement
by Gauss-Newton on the interpolated map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.pose import Pose2, wrap_angle
from slam_baselines.cartographer.loop_closure_config import ConstraintConfig
from slam_baselines.cartographer.submap import Submap
from slam_baselines.common.linalg import inverted
from slam_baselines.matching.branch_and_bound import Exclusion, Window, branch_and_bound
from slam_baselines.matching.gauss_newton import Match, Prior, ScanMatcher
from slam_baselines.scan.voxel_filter import voxel_filter


@dataclass(frozen=True, slots=True)
class LoopConstraint:
    """Pose of a node in the frame of a submap that it was not inserted into.

    Attributes:
        submap: index.
        node: index.
        T_submap_node: measured.
        information: (3, 3) its inverse covariance, in the submap's axes.
        score: mean occupancy at the ends of the beams.
    """

    submap: int
    node: int
    T_submap_node: Pose2
    information: FloatArray
    score: float = 1.0


class SubmapMatch(NamedTuple):
    """A scan matched to a submap.

    Attributes:
        pose: of the base in the submap's local frame.
        information: (3, 3) inverse covariance of the pose.
        score: mean occupancy at the ends of the beams; unknown cells count as 0.
    """

    pose: Pose2
    information: FloatArray
    score: float


@dataclass
class SearchCounts:
    """Outcomes of the searches.

    Attributes:
        searched: all of them.
        found: with a match.
        poor: without a match that fits well enough.
        given_up: after max_search_nodes.
        ambiguous: with two matches that fit equally well.
    """

    searched: int = 0
    found: int = 0
    poor: int = 0
    given_up: int = 0
    ambiguous: int = 0


class ConstraintBuilder:
    """Search for scans in submaps.

    Attributes:
        counts: outcomes of the searches.
    """

    def __init__(self, config: ConstraintConfig) -> None:
        self.config = config
        self.counts = SearchCounts()
        self._matcher = ScanMatcher(config.match)
        meters, radians = config.min_deviation
        self._min_covariance = np.diag((meters**2, meters**2, radians**2))

    def compute_constraint(
        self, submap: Submap, points: FloatArray, start: Pose2, distance_traveled: float
    ) -> SubmapMatch | None:
        """Match a scan to a submap; the search window grows with the distance traveled.

        Args:
            submap: finished.
            points: (n, 2 or more) hits on walls in the leveled base frame, meters.
            start: expected pose of the base in the submap's local frame.
            distance_traveled: distance from the nearest node with a constraint to the submap, meters.

        Returns:
            The match; None where the scan fits nowhere well.
        """
        self.counts.searched += 1
        sparse = voxel_filter(points, self.config.voxel_size, self.config.max_points)
        if len(sparse) < self.config.min_points:
            self.counts.poor += 1
            return None
        match = self._match_scan(submap, points, sparse, start.as_array(), distance_traveled)
        if match is None:
            return None
        self.counts.found += 1
        x, y, yaw = match.pose.tolist()
        information = inverted(inverted(match.information + 1e-3 * np.eye(3)) + self._min_covariance)
        return SubmapMatch(Pose2(x, y, wrap_angle(yaw)), information, match.score * match.known)

    def _match_scan(
        self,
        submap: Submap,
        points: FloatArray,
        sparse: FloatArray,
        start: FloatArray,
        distance_traveled: float,
    ) -> Match | None:
        """Match from the expected pose, if that is well known; else from the best pose of a window."""
        c = self.config
        linear = min(c.linear_search_window, c.linear_start + c.linear_drift * distance_traveled)
        angular = min(c.angular_search_window, c.angular_start + c.angular_drift * distance_traveled)
        if linear > c.max_refined_window:
            found = self._search_window(submap, sparse, start, Window(linear, angular))
            if found is None:
                return None
            start, linear, angular = found, *c.search_deviation
        prior = Prior(start, np.diag((linear**2, linear**2, angular**2)))
        match = self._matcher.match(submap, points, None, prior, levels=len(c.match.iterations))
        if match.score < c.min_refined_score or match.known < c.min_known_ratio:
            self.counts.poor += 1
            return None
        return match

    def _search_window(
        self, submap: Submap, points: FloatArray, start: FloatArray, window: Window
    ) -> FloatArray | None:
        """Search a window; None where nothing fits or, as along a corridor, two places fit equally well."""
        c = self.config
        min_score = c.min_score + (c.global_min_score - c.min_score) * window.linear / c.linear_search_window
        best = branch_and_bound(submap.bounds, points, start, window, min_score, c.max_search_nodes)
        self.counts.given_up += not best.complete
        if best.score < 0:
            self.counts.poor += 1
            return None
        second = branch_and_bound(
            submap.bounds, points, start, window, c.ambiguity_ratio * best.score, c.max_search_nodes,
            Exclusion(best.pose, c.min_separation),
        )  # fmt: skip
        if second.score >= 0 or not second.complete:
            self.counts.ambiguous += 1
            return None
        return best.pose
