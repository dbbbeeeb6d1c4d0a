"""Parameters of the original, by the names of its configuration files.

The defaults are those of trajectory_builder_2d.lua and pose_graph.lua, without IMU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lirs_wct.checks import Checked, limited


@dataclass(frozen=True, kw_only=True)
class AdaptiveVoxelFilterConfig(Checked, of="the adaptive voxel filter"):
    """Thinning of the points that are matched.

    Attributes:
        max_length: largest edge of a voxel, meters.
        min_num_points: fewest points that are kept, where a scan has so many.
        max_range: farther points are dropped, meters.
    """

    max_length: float = limited(0.5, "(0, inf]")
    min_num_points: int = limited(200, "(0, inf]")
    max_range: float = limited(50.0, "(0, inf]")


@dataclass(frozen=True, kw_only=True)
class OnlineSearchConfig(Checked, of="the online search"):
    """Exhaustive search around the predicted pose, real_time_correlative_scan_matcher.

    Attributes:
        linear_search_window: largest shift in x and in y, meters.
        angular_search_window: largest turn, radians.
        translation_delta_cost_weight: of the shift in the score, 1/m.
        rotation_delta_cost_weight: of the turn in the score, 1/rad.
    """

    linear_search_window: float = limited(0.1, "(0, inf]")
    angular_search_window: float = limited(math.radians(20.0), "(0, inf]")
    translation_delta_cost_weight: float = limited(0.1, "[0, inf]")
    rotation_delta_cost_weight: float = limited(0.1, "[0, inf]")


@dataclass(frozen=True, kw_only=True)
class CeresMatcherConfig(Checked, of="the scan matcher"):
    """Weights of the residuals of ceres_scan_matcher, and its solver.

    Attributes:
        occupied_space_weight: of the root mean square of 1 - p at the points.
        translation_weight: of the distance from the target, 1/m.
        rotation_weight: of the turn from the start, 1/rad.
        use_nonmonotonic_steps: whether steps may raise the cost.
        max_num_iterations: of the solver.
    """

    occupied_space_weight: float = limited(1.0, "(0, inf]")
    translation_weight: float = limited(10.0, "(0, inf]")
    rotation_weight: float = limited(40.0, "(0, inf]")
    use_nonmonotonic_steps: bool = False
    max_num_iterations: int = limited(20, "(0, inf]")


LOOP_MATCHER = CeresMatcherConfig(
    occupied_space_weight=20.0, rotation_weight=1.0, use_nonmonotonic_steps=True, max_num_iterations=10
)
"""Refinement of a loop."""


@dataclass(frozen=True, kw_only=True)
class ConstraintBuilderConfig(Checked, of="the constraint builder"):
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
    """

    sampling_ratio: float = limited(0.3, "(0, 1]")
    max_constraint_distance: float = limited(15.0, "(0, inf]")
    min_score: float = limited(0.55, "(0, 1]")
    loop_closure_translation_weight: float = limited(1.1e4, "(0, inf]")
    loop_closure_rotation_weight: float = limited(1e5, "(0, inf]")
    linear_search_window: float = limited(7.0, "(0, inf]")
    angular_search_window: float = limited(math.radians(30.0), "(0, inf]")
    branch_and_bound_depth: int = limited(7, "(0, inf]")
    ceres_scan_matcher: CeresMatcherConfig = LOOP_MATCHER


@dataclass(frozen=True, kw_only=True)
class PoseGraphConfig(Checked, of="the pose graph"):
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
    """

    optimize_every_n_nodes: int = limited(90, "(0, inf]")
    constraint_builder: ConstraintBuilderConfig = field(default_factory=ConstraintBuilderConfig)
    matcher_translation_weight: float = limited(5e2, "(0, inf]")
    matcher_rotation_weight: float = limited(1.6e3, "(0, inf]")
    local_slam_pose_translation_weight: float = limited(1e5, "(0, inf]")
    local_slam_pose_rotation_weight: float = limited(1e5, "(0, inf]")
    odometry_translation_weight: float = limited(1e5, "(0, inf]")
    odometry_rotation_weight: float = limited(1e5, "(0, inf]")
    huber_scale: float = limited(10.0, "(0, inf]")
    max_num_iterations: int = limited(50, "(0, inf]")
    max_num_final_iterations: int = limited(200, "(0, inf]")


@dataclass(frozen=True, kw_only=True)
class CartographerOriginalConfig(Checked):
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
    """

    min_range: float = limited(0.0, "[0, inf]")
    max_range: float = limited(30.0, "(0, inf]", "m")
    missing_data_ray_length: float = limited(5.0, "(0, inf]", "m")
    voxel_filter_size: float = limited(0.025, "(0, inf]", "m")
    adaptive_voxel_filter: AdaptiveVoxelFilterConfig = field(default_factory=AdaptiveVoxelFilterConfig)
    use_online_correlative_scan_matching: bool = False
    real_time_correlative_scan_matcher: OnlineSearchConfig = field(default_factory=OnlineSearchConfig)
    ceres_scan_matcher: CeresMatcherConfig = field(default_factory=CeresMatcherConfig)
    max_time_seconds: float = limited(5.0, "(0, inf]")
    max_distance_meters: float = limited(0.2, "[0, inf]")
    max_angle_radians: float = limited(math.radians(1.0), "[0, inf]")
    num_range_data: int = limited(90, "(0, inf]")
    resolution: float = limited(0.05, "(0, inf]", "m")
    hit_probability: float = limited(0.55, "(0.5, 0.9]")
    miss_probability: float = limited(0.49, "[0.1, 0.5)")
    pose_graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
