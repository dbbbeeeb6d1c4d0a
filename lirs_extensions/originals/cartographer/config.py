"""Parameters of the original, by the names of its configuration files.

The defaults are those of trajectory_builder_2d.lua and pose_graph.lua, without IMU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from lirs_wct.errors import Checked, limited


class CeresMatcher(NamedTuple):
    """Weights of the residuals of a scan matcher, and its solver (see CartographerOriginalConfig)."""

    occupied_space_weight: float
    translation_weight: float
    rotation_weight: float
    use_nonmonotonic_steps: bool
    max_num_iterations: int


@dataclass(frozen=True, kw_only=True)
class CartographerOriginalConfig(Checked, of="cartographer_original"):
    """Parameters of Cartographer 2D with its defaults.

    A prefix tells tables of the original apart that use the same name: `adaptive_` its
    adaptive_voxel_filter, `online_` its real_time_correlative_scan_matcher, `ceres_` the ceres_scan_matcher
    of local SLAM, `loop_` that of the constraint_builder.

    Attributes:
        min_range: Range up to which readings are dropped, meters.
        max_range: Range from which on readings count as beams without return, meters.
        missing_data_ray_length: Free length of a beam without return, meters.
        voxel_filter_size: Edge of the voxels of which each keeps one point, meters.
        adaptive_max_length: Largest edge of a voxel in the thinning of the points that are matched, meters.
        adaptive_min_num_points: Fewest points that this thinning keeps, where a scan has so many.
        adaptive_max_range: Range from which on this thinning drops points, meters.
        use_online_correlative_scan_matching: Whether an exhaustive search precedes the scan matcher.
        online_linear_search_window: Largest shift of this search in x and in y, meters.
        online_angular_search_window: Largest turn of this search, radians.
        translation_delta_cost_weight: Weight of the shift in its score, 1/m.
        rotation_delta_cost_weight: Weight of the turn in its score, 1/rad.
        ceres_occupied_space_weight: Weight of the root mean square of 1 - p at the points.
        ceres_translation_weight: Weight of the distance from the target, 1/m.
        ceres_rotation_weight: Weight of the turn from the start, 1/rad.
        ceres_use_nonmonotonic_steps: Whether steps may raise the cost.
        ceres_max_num_iterations: Most steps of the solver.
        max_time_seconds: Time after which a scan becomes a node, seconds.
        max_distance_meters: Distance after which a scan becomes a node, meters.
        max_angle_radians: Turn after which a scan becomes a node, radians.
        num_range_data: Nodes after which the next submap begins; each gets twice as many.
        resolution: Edge of a cell of the submaps and of the map, meters.
        hit_probability: Probability that a cell is occupied, given that a beam ended there.
        miss_probability: Probability that a cell is occupied, given that a beam passed it.
        sampling_ratio: Share of the nodes that are searched for in each submap.
        max_constraint_distance: Largest distance of a node from a submap's origin, meters.
        min_score: Mean probability at the points that a loop needs.
        loop_closure_translation_weight: Weight of a loop in the graph, 1/m.
        loop_closure_rotation_weight: Weight of a loop in the graph, 1/rad.
        linear_search_window: Largest shift of the loop search in x and in y, meters.
        angular_search_window: Largest turn of the loop search, radians.
        branch_and_bound_depth: Number of levels of the loop search.
        loop_occupied_space_weight: Weight of the root mean square of 1 - p in the refinement of a loop.
        loop_translation_weight: Weight of the distance from the found pose, 1/m.
        loop_rotation_weight: Weight of the turn from the found pose, 1/rad.
        loop_use_nonmonotonic_steps: Whether steps of this refinement may raise the cost.
        loop_max_num_iterations: Most steps of this refinement.
        optimize_every_n_nodes: Number of nodes after which the graph is optimized.
        matcher_translation_weight: Weight of a node's position in the submaps that it entered, 1/m.
        matcher_rotation_weight: Weight of a node's yaw in the submaps that it entered, 1/rad.
        local_slam_pose_translation_weight: Weight of the step from node to node by local SLAM, 1/m.
        local_slam_pose_rotation_weight: Weight of the turn from node to node by local SLAM, 1/rad.
        odometry_translation_weight: Weight of the step from node to node by odometry, 1/m.
        odometry_rotation_weight: Weight of the turn from node to node by odometry, 1/rad.
        huber_scale: Weighted error of a loop from which on it counts linearly.
        max_num_iterations: Most steps of the graph's solver.
        max_num_final_iterations: Most steps of the graph's solver in the last optimization.
    """

    min_range: float = limited(0.0, "[0, inf]")
    max_range: float = limited(30.0, "(0, inf]", "m")
    missing_data_ray_length: float = limited(5.0, "(0, inf]", "m")
    voxel_filter_size: float = limited(0.025, "(0, inf]", "m")
    adaptive_max_length: float = limited(0.5, "(0, inf]")
    adaptive_min_num_points: int = limited(200, "(0, inf]")
    adaptive_max_range: float = limited(50.0, "(0, inf]")
    use_online_correlative_scan_matching: bool = False
    online_linear_search_window: float = limited(0.1, "(0, inf]")
    online_angular_search_window: float = limited(math.radians(20.0), "(0, inf]")
    translation_delta_cost_weight: float = limited(0.1, "[0, inf]")
    rotation_delta_cost_weight: float = limited(0.1, "[0, inf]")
    ceres_occupied_space_weight: float = limited(1.0, "(0, inf]")
    ceres_translation_weight: float = limited(10.0, "(0, inf]")
    ceres_rotation_weight: float = limited(40.0, "(0, inf]")
    ceres_use_nonmonotonic_steps: bool = False
    ceres_max_num_iterations: int = limited(20, "(0, inf]")
    max_time_seconds: float = limited(5.0, "(0, inf]")
    max_distance_meters: float = limited(0.2, "[0, inf]")
    max_angle_radians: float = limited(math.radians(1.0), "[0, inf]")
    num_range_data: int = limited(90, "(0, inf]")
    resolution: float = limited(0.05, "(0, inf]", "m")
    hit_probability: float = limited(0.55, "(0.5, 0.9]")
    miss_probability: float = limited(0.49, "[0.1, 0.5)")
    sampling_ratio: float = limited(0.3, "(0, 1]")
    max_constraint_distance: float = limited(15.0, "(0, inf]")
    min_score: float = limited(0.55, "(0, 1]")
    loop_closure_translation_weight: float = limited(1.1e4, "(0, inf]")
    loop_closure_rotation_weight: float = limited(1e5, "(0, inf]")
    linear_search_window: float = limited(7.0, "(0, inf]")
    angular_search_window: float = limited(math.radians(30.0), "(0, inf]")
    branch_and_bound_depth: int = limited(7, "(0, inf]")
    loop_occupied_space_weight: float = limited(20.0, "(0, inf]")
    loop_translation_weight: float = limited(10.0, "(0, inf]")
    loop_rotation_weight: float = limited(1.0, "(0, inf]")
    loop_use_nonmonotonic_steps: bool = True
    loop_max_num_iterations: int = limited(10, "(0, inf]")
    optimize_every_n_nodes: int = limited(90, "(0, inf]")
    matcher_translation_weight: float = limited(5e2, "(0, inf]")
    matcher_rotation_weight: float = limited(1.6e3, "(0, inf]")
    local_slam_pose_translation_weight: float = limited(1e5, "(0, inf]")
    local_slam_pose_rotation_weight: float = limited(1e5, "(0, inf]")
    odometry_translation_weight: float = limited(1e5, "(0, inf]")
    odometry_rotation_weight: float = limited(1e5, "(0, inf]")
    huber_scale: float = limited(10.0, "(0, inf]")
    max_num_iterations: int = limited(50, "(0, inf]")
    max_num_final_iterations: int = limited(200, "(0, inf]")

    @property
    def ceres_matcher(self) -> CeresMatcher:
        """Scan matcher of local SLAM."""
        return CeresMatcher(*(getattr(self, f"ceres_{name}") for name in CeresMatcher._fields))

    @property
    def loop_matcher(self) -> CeresMatcher:
        """Refinement of a loop."""
        return CeresMatcher(*(getattr(self, f"loop_{name}") for name in CeresMatcher._fields))
