"""Parameters of Cartographer, under the original's names where they exist."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from lirs_wct.errors import ConfigError, limited, require_within
from lirs_wct.geometry import OccupancyGrid, Pose2
from slam_baselines.dead_reckoning import MotionConfig
from slam_baselines.front_end import FrontEndConfig
from slam_baselines.occupancy_map import UpdateConfig
from slam_baselines.registration import RegistrationConfig


@dataclass(frozen=True, kw_only=True)
class CartographerConfig(FrontEndConfig, RegistrationConfig, MotionConfig, UpdateConfig, of="cartographer"):
    """Parameters of local SLAM, of the pose graph, and of localization in a known map.

    The registration in a submap is permissive, because the pose graph corrects wrong matches of local SLAM.

    Attributes:
        map_resolution: Edge of a cell of the final map, meters.
        max_range: Range from which on hits are not used, meters.
        clear_range: Range up to which a beam without return is free, meters.
        map: Known map, a grid or the path of its YAML, in which the robot is only localized.
        start: `T_map_base` at the first scan in the known map; None: it is searched for in all of it.
        max_time_seconds: Longest time between two nodes.
        max_distance_meters: Largest distance between two nodes.
        max_angle_radians: Largest turn between two nodes.
        max_tilt_radians: Largest change of tilt between two nodes; it shows other heights of the same things.
        sparse_distance: Distance between two nodes from which on the hits of the later one are interpolated,
            meters.
        num_range_data: Scans after which the next submap begins; each gets twice as many.
        submap_distance: Distance traveled after which the next submap begins, however few the scans, meters.
        resolution: Edge of a cell of the submaps' finest level, meters.
        submap_levels: Number of levels, each twice as coarse as the one before.
        search_level: Level on which loops are searched for.
        max_search_cells: Cells along an edge of a submap from which on loops are searched for on a coarser
            level than the search_level.
        branch_and_bound_depth: Number of times that four cells become one in the loop search.
        max_unpacked_bytes: Memory of the finished submaps that are kept unpacked, as they were searched last.
        sampling_ratio: Share of the nodes that are searched for in the submaps around them.
        sampling_distance: Distance traveled in which at least one node is searched for, meters.
        max_constraint_distance: Largest distance of a node from a submap's nodes, meters.
        loops_per_pair: Loops after which no more are searched for between two submaps.
        searches_per_pair: Searches after which no more are made between two submaps.
        max_num_candidates: Length of the queue; the oldest candidates beyond it are dropped, and counted.
        min_score: Mean occupancy at the ends of the beams that a loop needs in the narrowest search; unknown
            cells count as 0.
        global_min_score: Mean occupancy that a loop needs in the widest search: the more poses there are, the
            more fit by chance.
        min_refined_score: Mean occupancy on known cells that a loop needs after refinement.
        min_known_ratio: Share of beams on known cells that a loop needs after refinement.
        loop_linear_window: Largest shift in x and in y, meters.
        loop_angular_window: Largest turn, radians.
        loop_linear_start: Shift at distance 0 from the last constraint, meters.
        loop_linear_drift: Growth of the shift per meter traveled since the last constraint.
        loop_angular_start: Turn at distance 0 from the last constraint, radians.
        loop_angular_drift: Growth of the turn per meter traveled since the last constraint, radians.
        max_refined_window: Window up to which refinement alone finds the pose, meters.
        ambiguity_ratio: Share of the best score from which on a second pose makes the best one ambiguous.
        loop_separation: Distance from a loop's best pose at which a second one counts, meters.
        loop_max_points: Most points for the loop search, evenly spread in space.
        loop_min_points: Fewest points for the loop search.
        voxel_size: Edge of the squares of which each keeps one point, meters.
        loop_search_nodes: Nodes of the tree after which a loop search is given up.
        verified_translation: Correction of a node above which a loop needs a second one, meters.
        verified_rotation: Correction of a node's yaw above which a loop needs a second one, radians.
        max_verifying_distance: Largest distance traveled between the two nodes, meters.
        min_verifying_distance: Smallest distance traveled between the two nodes, so that the second sees
            something else, meters.
        linear_tolerance: Largest difference between the two corrections, meters.
        angular_tolerance: Largest difference between the two corrections, radians.
        max_pending: Number of loops that may wait for a second one.
        optimize_every_n_nodes: Number of new nodes after which new loops make an optimization due.
        searches_per_update: Most loop searches in one update.
        matcher_translation_error: Standard deviation of a node's position in its submap, meters.
        matcher_rotation_error: Standard deviation of a node's yaw in its submap, radians.
        drift_translation: Standard deviation of the error that local SLAM makes from one node to the next a
            meter on, meters. It grows with that distance to the power of 3/2: the farther apart, the less do
            two scans see of the same.
        drift_rotation: Standard deviation of that error in yaw, radians.
        cauchy_scale: Error of a robust constraint, in standard deviations, at which Cauchy's loss bends.
        scale_reduction: Factor by which the loss is narrowed from step to step, above 1.
        max_num_iterations: Most steps of Levenberg-Marquardt in one optimization.
        function_tolerance: Relative decrease of the cost below which the optimization ends.
        initial_damping: Levenberg's damping of the first step, as a share of the diagonal.
        gauge_information: Information of the prior that holds the first node.
        fresh_submaps_count: Number of the newest finished submaps that are kept of each place.
        min_covered_area: Smallest area that a submap is kept for, square meters.
        min_added_submaps_count: Number of newly finished submaps after which trimming is due.
        trimming_cell: Edge of a square that counts as one place, meters.
        localization_min_score: Mean occupancy that a pose found in the whole known map needs.
        localization_separation: Distance from the best pose in the known map at which a second one counts,
            meters.
        localization_distance: Distance traveled after which the search in the known map is repeated, meters.
        localization_interval: Time after which the search in the known map is repeated, seconds.
        localization_max_points: Most points for the search in the known map, evenly spread in space.
        localization_min_points: Fewest points for the search in the known map.
        localization_search_nodes: Nodes of the tree after which a search in the known map is given up.
        start_deviation: Standard deviation of a pose that is given or found, meters and radians.

    Raises:
        ConfigError: a value is not legal, or there is a start without a map.
    """

    lost_score: float = limited(0.2, "(0, 1]")
    bootstrap_first: float = limited(2.0, "(0, inf]", "m")
    bootstrap_last: float = limited(math.inf, "(0, inf]", "m")
    min_gain: float = limited(0.0, "[0, inf]")
    search_prior: bool = True
    coasting: bool = False

    map_resolution: float = limited(0.05, "(0, inf]", "m")
    max_range: float = limited(math.inf, "(0, inf]", "m")
    clear_range: float = 0.0
    map: OccupancyGrid | str | Path | None = None
    start: Pose2 | None = None

    max_time_seconds: float = limited(math.inf, "[0, inf]")
    max_distance_meters: float = limited(0.2, "[0, inf]")
    max_angle_radians: float = limited(math.radians(10.0), "[0, inf]")
    max_tilt_radians: float = limited(math.radians(1.0), "[0, inf]")
    sparse_distance: float = limited(0.4, "(0, inf]")

    num_range_data: int = limited(60, "(0, inf]")
    submap_distance: float = limited(20.0, "(0, inf]")
    resolution: float = limited(0.05, "(0, inf]")
    submap_levels: int = limited(3, "(0, inf]")
    search_level: int = 1
    max_search_cells: int = limited(1500, "(0, inf]")
    branch_and_bound_depth: int = limited(6, "(0, inf]")
    max_unpacked_bytes: int = limited(160_000_000, "(0, inf]")

    sampling_ratio: float = limited(0.2, "(0, 1]")
    sampling_distance: float = limited(2.0, "(0, inf]")
    max_constraint_distance: float = limited(12.0, "(0, inf]")
    loops_per_pair: int = limited(8, "(0, inf]")
    searches_per_pair: int = limited(8, "(0, inf]")
    max_num_candidates: int = limited(2000, "(0, inf]")

    min_score: float = limited(0.4, "(0, inf]")
    global_min_score: float = limited(0.55, "(0, inf]")
    min_refined_score: float = limited(0.5, "(0, inf]")
    min_known_ratio: float = limited(0.4, "(0, inf]")
    loop_linear_window: float = limited(5.0, "(0, inf]")
    loop_angular_window: float = limited(math.radians(20.0), "(0, inf]")
    loop_linear_start: float = limited(0.3, "(0, inf]")
    loop_linear_drift: float = limited(0.03, "(0, inf]")
    loop_angular_start: float = limited(0.05, "(0, inf]")
    loop_angular_drift: float = limited(0.003, "(0, inf]")
    max_refined_window: float = limited(0.6, "(0, inf]")
    ambiguity_ratio: float = limited(0.9, "(0, 1]")
    loop_separation: float = limited(0.5, "(0, inf]")
    loop_max_points: int = limited(120, "(0, inf]")
    loop_min_points: int = limited(20, "(0, inf]")
    voxel_size: float = limited(0.1, "(0, inf]")
    loop_search_nodes: int = limited(60000, "(0, inf]")

    verified_translation: float = limited(0.4, "(0, inf]")
    verified_rotation: float = limited(0.06, "(0, inf]")
    max_verifying_distance: float = limited(25.0, "(0, inf]")
    min_verifying_distance: float = limited(0.5, "(0, inf]")
    linear_tolerance: float = limited(0.3, "(0, inf]")
    angular_tolerance: float = limited(0.04, "(0, inf]")
    max_pending: int = limited(50, "(0, inf]")

    optimize_every_n_nodes: int = limited(40, "(0, inf]")
    searches_per_update: int = limited(1, "(0, inf]")
    matcher_translation_error: float = limited(0.03, "(0, inf]")
    matcher_rotation_error: float = limited(0.01, "(0, inf]")
    drift_translation: float = limited(0.03, "(0, inf]")
    drift_rotation: float = limited(0.004, "(0, inf]")
    cauchy_scale: float = limited(3.0, "(0, inf]")
    scale_reduction: float = limited(2.0, "(1, inf]")
    max_num_iterations: int = limited(30, "(0, inf]")
    function_tolerance: float = limited(1e-4, "(0, inf]")
    initial_damping: float = limited(1e-4, "(0, inf]")
    gauge_information: float = limited(1e8, "(0, inf]")

    fresh_submaps_count: int = limited(3, "(0, inf]")
    min_covered_area: float = limited(4.0, "(0, inf]")
    min_added_submaps_count: int = limited(5, "(0, inf]")
    trimming_cell: float = limited(0.5, "(0, inf]")

    localization_min_score: float = limited(0.55, "(0, 1]")
    localization_separation: float = limited(1.0, "(0, inf]")
    localization_distance: float = limited(1.0, "(0, inf]")
    localization_interval: float = limited(5.0, "(0, inf]")
    localization_max_points: int = limited(150, "(0, inf]")
    localization_min_points: int = limited(30, "(0, inf]")
    localization_search_nodes: int = limited(1 << 20, "(0, inf]")
    start_deviation: tuple[float, float] = (0.3, 0.1)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, f"[{self.min_score}, 1]", "global_min_score")
        require_within(self, f"[0, {self.submap_levels - 1}]", "search_level")
        if self.start is not None and self.map is None:
            raise ConfigError("start is a pose in a known map: map is needed with it")
