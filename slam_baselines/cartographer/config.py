"""Parameters of Cartographer and of its parts, under the original's names where they exist."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from lirs_wct.checks import Checked, limited, require_within
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import OccupancyGrid, Pose2
from slam_baselines.dead_reckoning import MotionConfig
from slam_baselines.front_end import BootstrapConfig, MotionFilterConfig
from slam_baselines.ground_filter import GroundFilterConfig
from slam_baselines.leveling import InterpolationConfig
from slam_baselines.monitors import LocalizabilityConfig, TrackingConfig
from slam_baselines.occupancy_map import UpdateConfig
from slam_baselines.registration import MatchConfig, RegistrationConfig


@dataclass(frozen=True, kw_only=True)
class CandidateConfig(Checked, of="the candidates"):
    """Number of candidates that are tried.

    Attributes:
        sampling_ratio: share of the nodes that are searched for in the submaps around them.
        sampling_distance: distance traveled in which at least one node is searched for, meters.
        max_constraint_distance: largest distance of a node from a submap's nodes, meters.
        found_per_pair: loops after which no more are searched for between two submaps.
        tries_per_pair: searches after which no more are made between two submaps.
        max_num_candidates: length of the queue; the oldest candidates beyond it are dropped, and counted.
    """

    sampling_ratio: float = limited(0.2, "(0, 1]")
    sampling_distance: float = limited(2.0, "(0, inf]")
    max_constraint_distance: float = limited(12.0, "(0, inf]")
    found_per_pair: int = limited(8, "(0, inf]")
    tries_per_pair: int = limited(8, "(0, inf]")
    max_num_candidates: int = limited(2000, "(0, inf]")


@dataclass(frozen=True, kw_only=True)
class ConstraintConfig(Checked, of="the constraints"):
    """Window and scores of the loop search; names as in Cartographer's constraint_builder.

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

    min_score: float = limited(0.4, "(0, inf]")
    global_min_score: float = limited(0.55, "(0, inf]")
    min_refined_score: float = limited(0.5, "(0, inf]")
    min_known_ratio: float = limited(0.4, "(0, inf]")
    linear_search_window: float = limited(5.0, "(0, inf]")
    angular_search_window: float = limited(math.radians(20.0), "(0, inf]")
    linear_start: float = limited(0.3, "(0, inf]")
    linear_drift: float = limited(0.03, "(0, inf]")
    angular_start: float = limited(0.05, "(0, inf]")
    angular_drift: float = limited(0.003, "(0, inf]")
    max_refined_window: float = limited(0.6, "(0, inf]")
    ambiguity_ratio: float = limited(0.9, "(0, inf]")
    min_separation: float = limited(0.5, "(0, inf]")
    max_points: int = limited(120, "(0, inf]")
    min_points: int = limited(20, "(0, inf]")
    voxel_size: float = limited(0.1, "(0, inf]")
    max_search_nodes: int = limited(60000, "(0, inf]")
    match: MatchConfig = field(default_factory=lambda: MatchConfig(iterations=(8, 5, 5), exact=True))
    search_deviation: tuple[float, float] = (0.2, 0.05)
    min_deviation: tuple[float, float] = (0.02, 0.003)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, f"[{self.min_score}, 1]", "global_min_score", of="the constraints")


@dataclass(frozen=True, kw_only=True)
class LoopVerificationConfig(Checked, of="the loop verification"):
    """Limits above which a loop needs a second one, and tolerances of their agreement.

    Attributes:
        max_translation: correction of a node above which a loop needs a second one, meters.
        max_rotation: correction of a node's yaw above which a loop needs a second one, radians.
        max_separation: largest distance traveled between the two nodes, meters.
        min_separation: smallest distance traveled between the two nodes, so that the second sees something
            else, meters.
        linear_tolerance: largest difference between the two corrections, meters.
        angular_tolerance: largest difference between the two corrections, radians.
        max_pending: number of loops that may wait.
    """

    max_translation: float = limited(0.4, "(0, inf]")
    max_rotation: float = limited(0.06, "(0, inf]")
    max_separation: float = limited(25.0, "(0, inf]")
    min_separation: float = limited(0.5, "(0, inf]")
    linear_tolerance: float = limited(0.3, "(0, inf]")
    angular_tolerance: float = limited(0.04, "(0, inf]")
    max_pending: int = limited(50, "(0, inf]")


SUBMAP_REGISTRATION = RegistrationConfig(
    match=MatchConfig(exact=True),
    min_walls=15,
    min_gain=0.0,
    search_prior=True,
    coasting=False,
    reject_poor=False,
    mahalanobis_gate=math.inf,
)
"""Registration in a submap: permissive, because the pose graph corrects wrong matches of local SLAM."""


@dataclass(frozen=True, kw_only=True)
class SubmapConfig(Checked, of="the submaps"):
    """Size and resolution of submaps.

    Attributes:
        num_range_data: scans after which the next submap begins; each gets twice as many.
        max_distance: distance traveled after which the next submap begins, however few the scans, meters.
        resolution: edge of a cell of the finest level, meters.
        levels: number of levels, each twice as coarse as the one before.
        search_level: level on which loops are searched for.
        max_search_cells: cells along an edge of a submap from which on loops are searched for on a coarser
            level than the search_level.
        branch_and_bound_depth: number of times that four cells become one in the loop search.
        max_unpacked_bytes: memory of the finished submaps that are kept unpacked, because they were searched
            in last.
        update: of the occupancy by a scan. Milder than for a map to look at: the mean of many scans shows
            where within a cell a wall is.

    Raises:
        ConfigError: a number that is not above 0, or a search_level that is no level.
    """

    num_range_data: int = limited(60, "(0, inf]")
    max_distance: float = limited(20.0, "(0, inf]")
    resolution: float = limited(0.05, "(0, inf]")
    levels: int = limited(3, "(0, inf]")
    search_level: int = 1
    max_search_cells: int = limited(1500, "(0, inf]")
    branch_and_bound_depth: int = limited(6, "(0, inf]")
    max_unpacked_bytes: int = limited(160_000_000, "(0, inf]")
    update: UpdateConfig = field(default_factory=UpdateConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, f"[0, {self.levels - 1}]", "search_level", of="the submaps")


@dataclass(frozen=True, kw_only=True)
class LocalConfig(Checked, of="local SLAM"):
    """Parameters of local SLAM.

    Attributes:
        submaps: their size and resolution.
        motion_filter: motion after which a scan enters them.
        sparse_distance: distance traveled between two such scans from which on the hits of the later one are
            interpolated, meters.
        interpolation: of hits along surfaces.
        motion: errors of the odometry.
        registration: of a scan in the matching submap.
        ground_filter: separates hits on ground from hits on walls.
        slip_speed: speed at which wheels may slip; on uneven ground, a match that neither slip nor the
            odometry's errors explain is rejected, m/s and rad/s.
        slip_deviations: standard deviations of the odometry's errors that are allowed in addition to the
            slip.
        localizability: conditions for using matches where the attitude is known.
        tracking: mean occupancy at the ends of the beams below which a scan enters no submap.

    Raises:
        ConfigError: a value is not legal, or lost_score is above the registration's search_threshold.
    """

    submaps: SubmapConfig = field(default_factory=SubmapConfig)
    motion_filter: MotionFilterConfig = field(default_factory=MotionFilterConfig)
    sparse_distance: float = limited(0.4, "(0, inf]")
    interpolation: InterpolationConfig = field(default_factory=InterpolationConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    registration: RegistrationConfig = SUBMAP_REGISTRATION
    ground_filter: GroundFilterConfig = field(default_factory=GroundFilterConfig)
    slip_speed: float = 1.0
    slip_deviations: float = 4.0
    localizability: LocalizabilityConfig = field(default_factory=LocalizabilityConfig)
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(lost_score=0.2))

    def __post_init__(self) -> None:
        super().__post_init__()
        legal = f"(0, {self.registration.search_threshold}]"
        require_within(self.tracking, legal, "lost_score", of="the tracking")


@dataclass(frozen=True, kw_only=True)
class OptimizationConfig(Checked, of="the optimization"):
    """Parameters of the solver; names as in Cartographer's optimization_problem and in Ceres.

    Attributes:
        cauchy_scale: error of a robust constraint, in standard deviations, at which Cauchy's loss bends.
        scale_reduction: factor by which the loss is narrowed from step to step, above 1.
        max_num_iterations: of Levenberg-Marquardt in one optimization.
        function_tolerance: relative decrease of the cost below which the optimization ends.
        initial_damping: Levenberg's damping of the first step, as a share of the diagonal.
        gauge_information: information of the prior that holds the first node.
    """

    cauchy_scale: float = limited(3.0, "(0, inf]")
    scale_reduction: float = limited(2.0, "(1, inf]")
    max_num_iterations: int = limited(30, "(0, inf]")
    function_tolerance: float = limited(1e-4, "(0, inf]")
    initial_damping: float = limited(1e-4, "(0, inf]")
    gauge_information: float = limited(1e8, "(0, inf]")


@dataclass(frozen=True, kw_only=True)
class TrimmingConfig(Checked, of="the trimming"):
    """Submaps that are kept; names as in Cartographer's overlapping_submaps_trimmer_2d.

    Attributes:
        fresh_submaps_count: number of the newest finished submaps that are kept of each place.
        min_covered_area: smallest area that a submap is kept for, square meters.
        min_added_submaps_count: number of newly finished submaps after which trimming is due.
        cell: edge of a square that counts as one place, meters.
    """

    fresh_submaps_count: int = limited(3, "(0, inf]")
    min_covered_area: float = limited(4.0, "(0, inf]")
    min_added_submaps_count: int = limited(5, "(0, inf]")
    cell: float = limited(0.5, "(0, inf]")


@dataclass(frozen=True, kw_only=True)
class GlobalConfig(Checked, of="the graph"):
    """Parameters of global SLAM; names as in Cartographer's pose_graph.

    Attributes:
        candidates: pairs of nodes and submaps that are searched.
        constraints: loop search.
        verification: of loops that move the map far.
        optimization: of the graph.
        trimming: of redundant submaps.
        optimize_every_n_nodes: number of new nodes after which new loops make an optimization due.
        searches_per_update: most loop searches in one update.
        matcher_translation_error: standard deviation of a node's position in its submap, meters.
        matcher_rotation_error: standard deviation of a node's yaw in its submap, radians.
        drift_translation: standard deviation of the error that local SLAM makes from one node to the next a
            meter on, meters. It grows with that distance to the power of 3/2: the farther apart, the less do
            two scans see of the same.
        drift_rotation: the same of yaw, radians.
    """

    candidates: CandidateConfig = field(default_factory=CandidateConfig)
    constraints: ConstraintConfig = field(default_factory=ConstraintConfig)
    verification: LoopVerificationConfig = field(default_factory=LoopVerificationConfig)
    optimization: OptimizationConfig = field(default_factory=OptimizationConfig)
    trimming: TrimmingConfig = field(default_factory=TrimmingConfig)
    optimize_every_n_nodes: int = limited(40, "(0, inf]")
    searches_per_update: int = limited(1, "(0, inf]")
    matcher_translation_error: float = limited(0.03, "(0, inf]")
    matcher_rotation_error: float = limited(0.01, "(0, inf]")
    drift_translation: float = limited(0.03, "(0, inf]")
    drift_rotation: float = limited(0.004, "(0, inf]")


@dataclass(frozen=True, kw_only=True)
class LocalizationConfig(Checked, of="the localization"):
    """Search in a known map, and when its result is accepted.

    Attributes:
        min_score: mean occupancy at the ends of the beams that a pose found in the whole map needs.
        ambiguity_ratio: share of the best score from which on a second pose makes the best one ambiguous.
        min_separation: distance from the best pose at which a second one counts, meters.
        search_distance: distance traveled after which the search is repeated, meters.
        search_interval: time after which the search is repeated, seconds.
        max_points: most points for the search, evenly spread in space.
        min_points: fewest points for the search.
        max_search_nodes: nodes of the tree after which a search is given up.
        tracking: mean occupancy at the ends of the beams below which a scan does not fit.
        start_deviation: standard deviation of a pose that is given or found, meters and radians.
    """

    min_score: float = limited(0.55, "(0, 1]")
    ambiguity_ratio: float = limited(0.9, "(0, 1]")
    min_separation: float = limited(1.0, "(0, inf]")
    search_distance: float = limited(1.0, "(0, inf]")
    search_interval: float = limited(5.0, "(0, inf]")
    max_points: int = limited(150, "(0, inf]")
    min_points: int = limited(30, "(0, inf]")
    max_search_nodes: int = limited(1 << 20, "(0, inf]")
    localizability: LocalizabilityConfig = field(default_factory=LocalizabilityConfig)
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(lost_score=0.2))
    start_deviation: tuple[float, float] = (0.3, 0.1)


@dataclass(frozen=True, kw_only=True)
class CartographerConfig(Checked):
    """Parameters, in the parts' configurations under the original's names where they exist.

    Attributes:
        local: submaps, matching, motion filter.
        graph: loops and optimization.
        map_resolution: edge of a cell of the final map, meters.
        update: of the final map by a scan.
        bootstrap: when submaps are drawn again on uneven ground, until the first one is finished.
        max_range: range from which on hits are not used, meters.
        clear_range: range up to which a beam without return is free, meters.
        map: known map, a grid or the path of its YAML, in which the robot is only localized.
        start: `T_map_base` at the first scan in the known map; None: it is searched for in all of it.
        localization: search in the known map.

    Raises:
        ConfigError: a resolution or range that is not above 0, or a start without a map.
    """

    local: LocalConfig = field(default_factory=LocalConfig)
    graph: GlobalConfig = field(default_factory=GlobalConfig)
    map_resolution: float = limited(0.05, "(0, inf]", "m")
    update: UpdateConfig = field(default_factory=UpdateConfig)
    bootstrap: BootstrapConfig = field(default_factory=lambda: BootstrapConfig(first=2.0, last=math.inf))
    max_range: float = limited(math.inf, "(0, inf]", "m")
    clear_range: float = 0.0
    map: OccupancyGrid | str | Path | None = None
    start: Pose2 | None = None
    localization: LocalizationConfig = field(default_factory=LocalizationConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start is not None and self.map is None:
            raise ConfigError("start is a pose in a known map: map is needed with it")
