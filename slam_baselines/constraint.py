"""Loop closure: nodes found again in finished submaps, a bounded number of searches at a time.

Hess et al. 2016, section V-B: branch and bound for where a scan fits into a submap, then refinement
by Gauss-Newton on the interpolated map.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2, wrap_angle
from slam_baselines.branch_and_bound import branch_and_bound
from slam_baselines.scan_matching import MatchConfig, ScanMatcher
from slam_baselines.submap import Submap

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ConstraintConfig:
    """Where loops are searched for and which are believed; names as in constraint_builder.

    Attributes:
        sampling_ratio: share of the nodes that are searched for in the submaps around them.
        max_constraint_distance: nodes farther than this from a submap's nodes are not searched for, metres.
        min_score: mean occupancy at the ends of the beams that a loop needs.
        linear_search_window: shifts up to this in x and in y, metres.
        angular_search_window: turns up to this, radians.
        beams: at most so many beams are used to search, evenly spread in space.
        spread: one beam for each square of this size, metres.
        bounded: a search is given up after so many nodes of its tree.
        match: refinement.
        loose: standard deviation of the search's result for the refinement, metres and radians.
        floor: standard deviation that a loop has at least, metres and radians: submaps are not perfect.
        max_num_candidates: pairs that may wait; beyond that the oldest are dropped, and counted.

    Raises:
        ConfigError: a value that is not above 0, or a score or ratio above 1.
    """

    sampling_ratio: float = 0.3
    max_constraint_distance: float = 15.0
    min_score: float = 0.45
    linear_search_window: float = 4.0
    angular_search_window: float = math.radians(20.0)
    beams: int = 120
    spread: float = 0.1
    bounded: int = 60000
    match: MatchConfig = field(default_factory=lambda: MatchConfig(iterations=(8, 5)))
    loose: tuple[float, float] = (0.2, 0.05)
    floor: tuple[float, float] = (0.02, 0.003)
    max_num_candidates: int = 2000

    def __post_init__(self) -> None:
        for name in set(self.__dataclass_fields__) - {"match", "loose", "floor"}:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the constraints must be above 0, got {getattr(self, name)}")
        if max(self.min_score, self.sampling_ratio) > 1:
            raise ConfigError("min_score and sampling_ratio must be within (0, 1]")


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
    information: Array
    score: float = 1.0


@dataclass
class SearchCounts:
    """What the searches came to."""

    searched: int = 0
    found: int = 0
    poor: int = 0
    given_up: int = 0
    dropped: int = 0


class ConstraintBuilder:
    """The queue of pairs to be tried, and the trial.

    Attributes:
        counts: what became of them.
    """

    def __init__(self, config: ConstraintConfig) -> None:
        self.config = config
        self.counts = SearchCounts()
        self._queue: deque[tuple[int, int]] = deque()
        self._matcher = ScanMatcher(config.match)
        (metres, radians), (metres0, radians0) = config.loose, config.floor
        self._loose = np.diag((metres**-2, metres**-2, radians**-2))
        self._floor = np.diag((metres0**2, metres0**2, radians0**2))

    def __len__(self) -> int:
        return len(self._queue)

    def ask(self, node: int, submap: int) -> None:
        """Put a pair into the queue."""
        self._queue.append((node, submap))
        if len(self._queue) > self.config.max_num_candidates:
            self._queue.popleft()
            self.counts.dropped += 1

    def next(self) -> tuple[int, int]:
        """Take the next pair out of the queue."""
        return self._queue.popleft()

    def search(self, submap: Submap, points: Array, start: Pose2) -> tuple[Pose2, Array, float] | None:
        """Look for a scan in a submap.

        Args:
            submap: finished.
            points: (n, 2 or more) hits on walls in the levelled base frame, metres.
            start: expected pose of the base in the submap's local frame.

        Returns:
            Pose of the base in the submap's local frame, its information there, and the score; None where the
            scan fits nowhere well.
        """
        c, counts = self.config, self.counts
        counts.searched += 1
        sparse = spread(points, c.spread, c.beams)
        if len(sparse) < 20:
            counts.poor += 1
            return None
        found = branch_and_bound(
            submap.bounds, sparse, start.as_array(), c.linear_search_window, c.angular_search_window, c.min_score, c.bounded
        )
        counts.given_up += not found.complete
        if found.score < 0:
            counts.poor += 1
            return None
        match = self._matcher.match(
            submap.pyramid, points, np.ones(len(points)), found.pose, self._loose, len(c.match.iterations)
        )
        if match.score * match.known < c.min_score:
            counts.poor += 1
            return None
        counts.found += 1
        x, y, yaw = match.pose.tolist()
        information = np.linalg.inv(np.linalg.inv(match.information + 1e-3 * np.eye(3)) + self._floor)
        return Pose2(x, y, wrap_angle(yaw)), information, match.score * match.known


def spread(points: Array, size: float, most: int) -> Array:
    """Return at most `most` of the points, at first one for each square of the given size."""
    cells = np.floor(points[:, :2] / size).astype(np.int64)
    _, first = np.unique(cells[:, 0] * (1 << 20) + cells[:, 1], return_index=True)
    first.sort()
    stride = max(1, -(-len(first) // most))
    return points[first[::stride]]


def seen_from(submap: Pose2, information: Array) -> Array:
    """Turn the information of x, y, yaw from the local frame into the axes of a submap."""
    c, s = math.cos(submap.yaw), math.sin(submap.yaw)
    R = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
    turned: Array = R @ information @ R.T
    return turned
