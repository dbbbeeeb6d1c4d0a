"""Configuration of loop closure: which pairs are searched, what makes a constraint, which are believed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lirs_wct.field_validators import number_fields, require_above, require_within
from slam_baselines.matching.gauss_newton import MatchConfig


@dataclass(frozen=True, kw_only=True)
class CandidateConfig:
    """Number of candidates that are tried.

    Attributes:
        sampling_ratio: share of the nodes that are searched for in the submaps around them.
        sampling_distance: distance traveled in which at least one node is searched for, meters.
        max_constraint_distance: largest distance of a node from a submap's nodes, meters.
        found_per_pair: loops after which no more are searched for between two submaps.
        tries_per_pair: searches after which no more are made between two submaps.
        max_num_candidates: length of the queue; the oldest candidates beyond it are dropped, and counted.

    Raises:
        ConfigError: a value that is not above 0, or a ratio above 1.
    """

    sampling_ratio: float = 0.2
    sampling_distance: float = 2.0
    max_constraint_distance: float = 12.0
    found_per_pair: int = 8
    tries_per_pair: int = 8
    max_num_candidates: int = 2000

    def __post_init__(self) -> None:
        require_within(self, "(0, 1]", "sampling_ratio", of="the candidates")
        require_above(self, 0, *self.__dataclass_fields__, of="the candidates")


@dataclass(frozen=True, kw_only=True)
class ConstraintConfig:
    """Window of the loop search, and the scores that a loop needs; names as in constraint_builder.

    Attributes:
        min_score: mean occupancy at the ends of the beams that a loop needs in the narrowest search; unknown
            cells count as 0.
        global_min_score: the same in the widest search: the more poses there are, the more fit by chance.
        min_refined_score: mean occupancy on known cells that a loop needs after refinement.
        min_known_ratio: share of beams on known cells that a loop needs after refinement.
        linear_search_window: largest shift in x and in y, meters.
        angular_search_window: largest turn, radians.
        linear_start: shift at distance 0 from the last constraint, meters.
        linear_drift: growth of the shift per meter traveled since the last constraint.
        angular_start: turn at distance 0 from the last constraint, radians.
        angular_drift: growth of the turn per meter traveled since the last constraint, radians.
        max_refined_window: window up to which refinement alone finds the pose, meters.
        ambiguity_ratio: share of the best score from which on a second pose makes the best one ambiguous.
        min_separation: distance from the best pose at which a second one counts, meters.
        max_points: most points for the search, evenly spread in space.
        min_points: fewest points for the search.
        voxel_size: edge of the squares of which each keeps one point, meters.
        max_search_nodes: nodes of the tree after which a search is given up.
        match: refinement.
        search_deviation: standard deviation of the search's result for the refinement, meters and radians.
        min_deviation: smallest standard deviation of a loop, meters and radians: submaps are not perfect.

    Raises:
        ConfigError: a value that is not above 0, or scores not in order.
    """

    min_score: float = 0.4
    global_min_score: float = 0.55
    min_refined_score: float = 0.5
    min_known_ratio: float = 0.4
    linear_search_window: float = 5.0
    angular_search_window: float = math.radians(20.0)
    linear_start: float = 0.3
    linear_drift: float = 0.03
    angular_start: float = 0.05
    angular_drift: float = 0.003
    max_refined_window: float = 0.6
    ambiguity_ratio: float = 0.9
    min_separation: float = 0.5
    max_points: int = 120
    min_points: int = 20
    voxel_size: float = 0.1
    max_search_nodes: int = 60000
    match: MatchConfig = field(default_factory=lambda: MatchConfig(iterations=(8, 5, 5), exact=True))
    search_deviation: tuple[float, float] = (0.2, 0.05)
    min_deviation: tuple[float, float] = (0.02, 0.003)

    def __post_init__(self) -> None:
        require_above(self, 0, *number_fields(self), of="the constraints")
        require_within(self, f"[{self.min_score}, 1]", "global_min_score", of="the constraints")


@dataclass(frozen=True, kw_only=True)
class LoopVerificationConfig:
    """Loops that need a second one, and what agreement is.

    Attributes:
        max_translation: correction of a node above which a loop needs a second one, meters.
        max_rotation: correction of a node's yaw above which a loop needs a second one, radians.
        max_separation: largest distance traveled between the two nodes, meters.
        min_separation: smallest distance traveled between the two nodes, so that the second sees something
            else, meters.
        linear_tolerance: largest difference between the two corrections, meters.
        angular_tolerance: largest difference between the two corrections, radians.
        max_pending: number of loops that may wait.

    Raises:
        ConfigError: a value that is not above 0.
    """

    max_translation: float = 0.4
    max_rotation: float = 0.06
    max_separation: float = 25.0
    min_separation: float = 0.5
    linear_tolerance: float = 0.3
    angular_tolerance: float = 0.04
    max_pending: int = 50

    def __post_init__(self) -> None:
        require_above(self, 0, *self.__dataclass_fields__, of="the loop verification")
