"""Parameters of the original, by the names of its configuration files.

The defaults are those of trajectory_builder_2d.lua and pose_graph.lua, without IMU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lirs_wct.field_validators import number_fields, require_above, require_at_least, require_within


@dataclass(frozen=True, kw_only=True)
class AdaptiveVoxelFilterConfig:
    """Thinning of the points that are matched.

    Attributes:
        max_length: largest edge of a voxel, meters.
        min_num_points: fewest points that are kept, where a scan has so many.
        max_range: farther points are dropped, meters.

    Raises:
        ConfigError: a value that is not above 0.
    """

    max_length: float = 0.5
    min_num_points: int = 200
    max_range: float = 50.0

    def __post_init__(self) -> None:
        require_above(self, 0, *number_fields(self), of="the adaptive voxel filter")


@dataclass(frozen=True, kw_only=True)
class OnlineSearchConfig:
    """Exhaustive search around the predicted pose, real_time_correlative_scan_matcher.

    Attributes:
        linear_search_window: largest shift in x and in y, meters.
        angular_search_window: largest turn, radians.
        translation_delta_cost_weight: of the shift in the score, 1/m.
        rotation_delta_cost_weight: of the turn in the score, 1/rad.

    Raises:
        ConfigError: a window that is not above 0, or a weight below 0.
    """

    linear_search_window: float = 0.1
    angular_search_window: float = math.radians(20.0)
    translation_delta_cost_weight: float = 0.1
    rotation_delta_cost_weight: float = 0.1

    def __post_init__(self) -> None:
        windows = ("linear_search_window", "angular_search_window")
        require_above(self, 0, *windows, of="the online search")
        weights = ("translation_delta_cost_weight", "rotation_delta_cost_weight")
        require_at_least(self, 0, *weights, of="the online search")


@dataclass(frozen=True, kw_only=True)
class CeresMatcherConfig:
    """Weights of the residuals of ceres_scan_matcher, and its solver.

    Attributes:
        occupied_space_weight: of the root mean square of 1 - p at the points.
        translation_weight: of the distance from the target, 1/m.
        rotation_weight: of the turn from the start, 1/rad.
        use_nonmonotonic_steps: whether steps may raise the cost.
        max_num_iterations: of the solver.

    Raises:
        ConfigError: a value that is not above 0.
    """

    occupied_space_weight: float = 1.0
    translation_weight: float = 10.0
    rotation_weight: float = 40.0
    use_nonmonotonic_steps: bool = False
    max_num_iterations: int = 20

    def __post_init__(self) -> None:
        names = ("occupied_space_weight", "translation_weight", "rotation_weight", "max_num_iterations")
        require_above(self, 0, *names, of="the scan matcher")


LOOP_MATCHER = CeresMatcherConfig(
    occupied_space_weight=20.0, rotation_weight=1.0, use_nonmonotonic_steps=True, max_num_iterations=10
)
"""Refinement of a loop."""


@dataclass(frozen=True, kw_only=True)
class ConstraintBuilderConfig:
    """Loop search.

    Attributes:
        sampling_ratio: share of the nodes that are searched for in each submap.
        max_constraint_distance: largest distance of a node from a submap's origin, meters.
        min_score: mean probability at the points that a loop needs.
        loop_closure_translation_weight: of a loop in the graph, 1/m.
        loop_closure_rotation_weight: of a loop in the graph, 1/rad.
        linear_search_window: largest shift in x and in y, meters.
        angular_search_window: largest turn, radians.
        branch_and_bound_depth: number of levels of the search.
        ceres_scan_matcher: refinement.

    Raises:
        ConfigError: a value that is not above 0, or a ratio or score above 1.
    """

    sampling_ratio: float = 0.3
    max_constraint_distance: float = 15.0
    min_score: float = 0.55
    loop_closure_translation_weight: float = 1.1e4
    loop_closure_rotation_weight: float = 1e5
    linear_search_window: float = 7.0
    angular_search_window: float = math.radians(30.0)
    branch_and_bound_depth: int = 7
    ceres_scan_matcher: CeresMatcherConfig = LOOP_MATCHER

    def __post_init__(self) -> None:
        require_above(self, 0, *number_fields(self), of="the constraint builder")
        require_within(self, "(0, 1]", "sampling_ratio", "min_score", of="the constraint builder")


@dataclass(frozen=True, kw_only=True)
class PoseGraphConfig:
    """Weights of the pose graph's residuals, and its solver.

    Attributes:
        optimize_every_n_nodes: number of nodes after which the graph is optimized.
        constraint_builder: loop search.
        matcher_translation_weight: of a node in the submaps that it entered, 1/m.
        matcher_rotation_weight: the same of its yaw, 1/rad.
        local_slam_pose_translation_weight: of the step from node to node by local SLAM, 1/m.
        local_slam_pose_rotation_weight: the same of the yaw, 1/rad.
        odometry_translation_weight: of the step from node to node by odometry, 1/m.
        odometry_rotation_weight: the same of the yaw, 1/rad.
        huber_scale: weighted error of a loop from which on it counts linearly.
        max_num_iterations: of the solver.
        max_num_final_iterations: of the solver in the last optimization.

    Raises:
        ConfigError: a value that is not above 0.
    """

    optimize_every_n_nodes: int = 90
    constraint_builder: ConstraintBuilderConfig = field(default_factory=ConstraintBuilderConfig)
    matcher_translation_weight: float = 5e2
    matcher_rotation_weight: float = 1.6e3
    local_slam_pose_translation_weight: float = 1e5
    local_slam_pose_rotation_weight: float = 1e5
    odometry_translation_weight: float = 1e5
    odometry_rotation_weight: float = 1e5
    huber_scale: float = 10.0
    max_num_iterations: int = 50
    max_num_final_iterations: int = 200

    def __post_init__(self) -> None:
        require_above(self, 0, *number_fields(self), of="the pose graph")


@dataclass(frozen=True, kw_only=True)
class CartographerOriginalConfig:
    """Parameters of Cartographer 2D with its defaults.

    Attributes:
        min_range: nearer readings are dropped, meters.
        max_range: farther readings count as beams without return, meters.
        missing_data_ray_length: free length of a beam without return, meters.
        voxel_filter_size: edge of the voxels of which each keeps one point, meters.
        adaptive_voxel_filter: thinning of the points that are matched.
        use_online_correlative_scan_matching: whether an exhaustive search precedes the scan matcher.
        real_time_correlative_scan_matcher: this search.
        ceres_scan_matcher: scan matcher of local SLAM.
        max_time_seconds: time after which a scan becomes a node, seconds.
        max_distance_meters: distance after which a scan becomes a node, meters.
        max_angle_radians: turn after which a scan becomes a node, radians.
        num_range_data: nodes after which the next submap begins; each gets twice as many.
        resolution: edge of a cell of the submaps and of the map, meters.
        hit_probability: probability that a cell is occupied, given that a beam ended there.
        miss_probability: probability that a cell is occupied, given that a beam passed it.
        pose_graph: loops and optimization.

    Raises:
        ConfigError: a value that is not above 0, or a probability on the wrong side of 0.5.
    """

    min_range: float = 0.0
    max_range: float = 30.0
    missing_data_ray_length: float = 5.0
    voxel_filter_size: float = 0.025
    adaptive_voxel_filter: AdaptiveVoxelFilterConfig = field(default_factory=AdaptiveVoxelFilterConfig)
    use_online_correlative_scan_matching: bool = False
    real_time_correlative_scan_matcher: OnlineSearchConfig = field(default_factory=OnlineSearchConfig)
    ceres_scan_matcher: CeresMatcherConfig = field(default_factory=CeresMatcherConfig)
    max_time_seconds: float = 5.0
    max_distance_meters: float = 0.2
    max_angle_radians: float = math.radians(1.0)
    num_range_data: int = 90
    resolution: float = 0.05
    hit_probability: float = 0.55
    miss_probability: float = 0.49
    pose_graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)

    def __post_init__(self) -> None:
        lengths = ("max_range", "missing_data_ray_length", "voxel_filter_size", "resolution")
        require_above(self, 0, *lengths, unit="m")
        require_above(self, 0, "max_time_seconds", "num_range_data")
        require_at_least(self, 0, "min_range", "max_distance_meters", "max_angle_radians")
        require_within(self, "(0.5, 0.9]", "hit_probability")
        require_within(self, "[0.1, 0.5)", "miss_probability")
