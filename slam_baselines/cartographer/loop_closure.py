"""Loop closure: candidate pairs of node and submap, search, verification of distant loops.

Hess et al. 2016, section V-B: branch and bound over the poses of a scan in a submap, then refinement by
Gauss-Newton on the interpolated map. One corridor looks like the next, so a single match in a wide window is
no proof. A loop that would move the map far waits for a second one of the same stretch that agrees.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lirs_wct.geometry import FloatArray, Pose2, wrap_angle
from slam_baselines.cartographer.branch_and_bound import Exclusion, SearchWindow, branch_and_bound
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.submap import Submap
from slam_baselines.dead_reckoning import PoseEstimate
from slam_baselines.leveling import voxel_filter
from slam_baselines.registration import Match, ScanMatcher

LOOP_ITERATIONS = (8, 5, 5)
"""Largest numbers of Gauss-Newton steps in the refinement of a loop on each level."""
SEARCH_DEVIATION = 0.2, 0.05
"""Standard deviation of the search's result for the refinement, meters and radians."""
MIN_DEVIATION = 0.02, 0.003
"""Smallest standard deviation of a loop, meters and radians: submaps are not perfect."""
Candidate = tuple[int, int]
"""Index of a node, index of a submap."""


class CandidateQueue:
    """Candidates that wait for their search, and the number dropped because too many waited."""

    def __init__(self, config: CartographerConfig) -> None:
        self.config = config
        self.dropped = 0
        self._new_nodes: deque[Candidate] = deque()
        self._old_nodes: deque[Candidate] = deque()
        self._tried: Counter[tuple[int, int]] = Counter()
        self._found: Counter[tuple[int, int]] = Counter()
        self._home: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self._new_nodes) + len(self._old_nodes)

    def add_candidate(self, node: int, home: int, submap: int, *, new_node: bool) -> None:
        """Put a node into the queue, to be searched for in a submap.

        It was inserted into the submap `home`; it is new, or else the submap is.
        """
        self._home[node] = home
        queue = self._new_nodes if new_node else self._old_nodes
        queue.append((node, submap))
        if len(queue) > self.config.max_num_candidates:
            queue.popleft()
            self.dropped += 1

    def next_candidate(self) -> Candidate | None:
        """Take the next candidate out of the queue; None if no search is left."""
        c = self.config
        while self._new_nodes or self._old_nodes:
            node, submap = self._new_nodes.pop() if self._new_nodes else self._old_nodes.popleft()
            pair = self._home[node], submap
            if self._found[pair] < c.loops_per_pair and self._tried[pair] < c.searches_per_pair:
                return node, submap
        return None

    def record_result(self, node: int, submap: int, *, found: bool) -> None:
        """Count a search and its success."""
        pair = self._home[node], submap
        self._tried[pair] += 1
        self._found[pair] += found


@dataclass(frozen=True, slots=True)
class LoopConstraint:
    """Pose of a node in the frame of a submap that it did not enter.

    Attributes:
        information: (3, 3) inverse covariance of the pose, in the submap's axes.
        score: Mean occupancy at the ends of the beams.
    """

    submap: int
    node: int
    T_submap_node: Pose2
    information: FloatArray
    score: float = 1.0


class SubmapMatch(NamedTuple):
    """Pose of the base in a submap's local frame, and its inverse covariance (3, 3).

    The score is the mean occupancy at the ends of the beams, where unknown cells count as 0.
    """

    pose: Pose2
    information: FloatArray
    score: float


@dataclass
class SearchCounts:
    """Outcomes of the searches; ambiguous ones fit equally well twice."""

    searched: int = 0
    found: int = 0
    given_up: int = 0
    ambiguous: int = 0


class ConstraintBuilder:
    """Search for scans in submaps; counts the outcomes."""

    def __init__(self, config: CartographerConfig) -> None:
        self.config = config
        self.counts = SearchCounts()
        self._matcher = ScanMatcher(LOOP_ITERATIONS, exact=True)
        meters, radians = MIN_DEVIATION
        self._min_covariance = np.diag((meters**2, meters**2, radians**2))

    def compute_constraint(
        self, submap: Submap, points: FloatArray, start: Pose2, distance_traveled: float
    ) -> SubmapMatch | None:
        """Match a scan to a finished submap; None where it fits nowhere well.

        Args:
            submap: Finished submap.
            points: (n, 2 or more) hits on walls in the leveled base frame, meters.
            start: Expected pose of the base in the submap's local frame.
            distance_traveled: Distance from the nearest node with a constraint to the submap, meters, with
                which the search window grows.
        """
        self.counts.searched += 1
        sparse = voxel_filter(points, self.config.voxel_size, self.config.loop_max_points)
        if len(sparse) < self.config.loop_min_points:
            return None
        match = self._match_scan(submap, points, sparse, start.as_array(), distance_traveled)
        if match is None:
            return None
        self.counts.found += 1
        x, y, yaw = match.pose.tolist()
        information = np.linalg.inv(
            np.linalg.inv(match.information + 1e-3 * np.eye(3)) + self._min_covariance
        )
        return SubmapMatch(Pose2(x, y, wrap_angle(yaw)), information, match.score * match.known)

    def _match_scan(
        self,
        submap: Submap,
        points: FloatArray,
        sparse: FloatArray,
        start: FloatArray,
        distance_traveled: float,
    ) -> Match | None:
        """Match from a well-known expected pose, else from the best pose of a window."""
        c = self.config
        linear = min(c.loop_linear_window, c.loop_linear_start + c.loop_linear_drift * distance_traveled)
        angular = min(c.loop_angular_window, c.loop_angular_start + c.loop_angular_drift * distance_traveled)
        if linear > c.max_refined_window:
            found = self._search_window(submap, sparse, start, SearchWindow(linear, angular))
            if found is None:
                return None
            start, linear, angular = found, *SEARCH_DEVIATION
        prior = PoseEstimate(Pose2(*start.tolist()), np.diag((linear**2, linear**2, angular**2)))
        match = self._matcher.match(submap, points, None, prior, levels=len(LOOP_ITERATIONS))
        if match.score < c.min_refined_score or match.known < c.min_known_ratio:
            return None
        return match

    def _search_window(
        self, submap: Submap, points: FloatArray, start: FloatArray, window: SearchWindow
    ) -> FloatArray | None:
        """Search a window; None if no pose fits, or two fit equally well."""
        c = self.config
        min_score = c.min_score + (c.global_min_score - c.min_score) * window.linear / c.loop_linear_window
        best = branch_and_bound(submap.bounds, points, start, window, min_score, c.loop_search_nodes)
        self.counts.given_up += not best.complete
        if best.score < 0:
            return None
        second = branch_and_bound(
            submap.bounds, points, start, window, c.ambiguity_ratio * best.score, c.loop_search_nodes,
            Exclusion(best.pose, c.loop_separation),
        )  # fmt: skip
        if second.score >= 0 or not second.complete:
            self.counts.ambiguous += 1
            return None
        return best.pose


class LoopVerification:
    """Loops that wait for a second one."""

    def __init__(self, config: CartographerConfig) -> None:
        self._config = config
        self._pending: deque[tuple[LoopConstraint, float]] = deque(maxlen=config.max_pending)

    def __len__(self) -> int:
        return len(self._pending)

    def verify_loop(
        self, loop: LoopConstraint, distance_traveled: float, submaps: Sequence[Pose2], nodes: Sequence[Pose2]
    ) -> list[LoopConstraint]:
        """Return the loops accepted now: none, the given one, or it with agreeing ones.

        Distance traveled until its node, meters; present poses `T_map_submap` and `T_map_base` of all submaps
        and nodes.
        """
        c = self._config
        here = nodes[loop.node]
        there = submaps[loop.submap] @ loop.T_submap_node
        turn = abs(wrap_angle(there.yaw - here.yaw))
        if there.distance(here) <= c.verified_translation and turn <= c.verified_rotation:
            return [loop]
        agreeing = []
        for other, other_distance in self._pending:
            between = abs(distance_traveled - other_distance)
            if c.min_verifying_distance <= between <= c.max_verifying_distance:
                correction = submaps[other.submap] @ other.T_submap_node @ nodes[other.node].inverse()
                expected = correction @ here
                turn = abs(wrap_angle(expected.yaw - there.yaw))
                if expected.distance(there) <= c.linear_tolerance and turn <= c.angular_tolerance:
                    agreeing.append(other)
        if not agreeing:
            self._pending.append((loop, distance_traveled))
            return []
        accepted = {(o.node, o.submap) for o in agreeing}
        self._pending = deque(
            (p for p in self._pending if (p[0].node, p[0].submap) not in accepted), maxlen=c.max_pending
        )
        return [*agreeing, loop]


@dataclass(frozen=True, slots=True)
class LoopEvent:
    """A scan that was matched to an older submap, and accepted.

    Attributes:
        stamp: Time of the scan, seconds.
        seen: stamp of the submap's first scan, seconds.
        before: `T_map_base` of the scan before the loop was closed.
        after: `T_map_base` of the scan according to the loop.
        score: mean occupancy at the ends of its beams there, 0 to 1.
    """

    stamp: float
    seen: float
    before: Pose2
    after: Pose2
    score: float

    @property
    def distance(self) -> float:
        """Distance by which the loop moves the scan, meters."""
        return self.before.distance(self.after)
