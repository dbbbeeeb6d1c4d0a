"""Planar Cartographer with the behavior and the defaults of its original.

The mechanisms are those of `cartographer` without its additions: attitude, ground filter, refined start,
wider search of local SLAM, tracking monitor, verification of loops, trimming. The defaults are those of the
original's trajectory_builder_2d.lua and pose_graph.lua. Differences from the original remain: bilinear
instead of bicubic interpolation of the submap, all beams instead of the adaptive voxel filter's 200, Cauchy's
loss instead of Huber's, and the weights of the graph. It was never compared with runs of the original, since
none are available.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import Imu, LaserScan, Pose2
from slam_baselines.cartographer.config import (
    CandidateConfig,
    CartographerConfig,
    ConstraintConfig,
    GlobalConfig,
    LocalConfig,
    LoopVerificationConfig,
    SubmapConfig,
    TrimmingConfig,
)
from slam_baselines.cartographer.mapper import CartographerMapper
from slam_baselines.matching.gauss_newton import MatchConfig
from slam_baselines.matching.registration import RegistrationConfig
from slam_baselines.matching.tracking_monitor import TrackingConfig
from slam_baselines.motion.motion_filter import MotionFilterConfig

NEVER = 1e-9
"""A score that every scan reaches."""
ALWAYS = 1 << 30
"""A number that nothing reaches."""

LOCAL = LocalConfig(
    submaps=SubmapConfig(
        num_range_data=90, max_distance=math.inf, levels=1, search_level=0, branch_and_bound_depth=7
    ),
    motion_filter=MotionFilterConfig(
        max_time_seconds=5.0, max_angle_radians=math.radians(1.0), max_tilt_radians=math.inf
    ),
    registration=RegistrationConfig(
        match=MatchConfig(iterations=(20,), exact=True),
        search_threshold=NEVER,
        min_beams=1,
        decorrelation_distance=NEVER,
        min_information_share=1 - NEVER,
        translation_weight=10.0,
        rotation_weight=40.0,
    ),
    tracking=TrackingConfig(lost_score=NEVER),
    sparse_distance=math.inf,
)
"""trajectory_builder_2d.lua: submaps, motion_filter, ceres_scan_matcher; no real-time correlative matcher."""

GRAPH = GlobalConfig(
    candidates=CandidateConfig(
        sampling_ratio=0.3,
        sampling_distance=math.inf,
        max_constraint_distance=15.0,
        found_per_pair=ALWAYS,
        tries_per_pair=ALWAYS,
    ),
    constraints=ConstraintConfig(
        min_score=0.55,
        global_min_score=0.6,
        min_refined_score=NEVER,
        min_known_ratio=NEVER,
        linear_search_window=7.0,
        angular_search_window=math.radians(30.0),
        linear_start=7.0,
        angular_start=math.radians(30.0),
        ambiguity_ratio=1.0,
        max_points=200,
        match=MatchConfig(iterations=(10,), exact=True),
    ),
    verification=LoopVerificationConfig(max_translation=math.inf, max_rotation=math.inf),
    trimming=TrimmingConfig(min_added_submaps_count=ALWAYS),
    drift_translation=NEVER,
    drift_rotation=NEVER,
    optimize_every_n_nodes=90,
)
"""pose_graph.lua: constraint_builder, optimize_every_n_nodes."""
WARM_UP = {
    "local": replace(LOCAL, submaps=replace(LOCAL.submaps, num_range_data=20)),
    "graph": replace(GRAPH, optimize_every_n_nodes=5),
}
"""Configuration with which a short drive reaches every kernel: small submaps, often optimized."""


@dataclass(frozen=True, kw_only=True)
class CartographerOriginalConfig(CartographerConfig):
    """Parameters as of CartographerConfig, with the original's defaults.

    Raises:
        ConfigError: a map to localize in, or a value that CartographerConfig refuses.
    """

    local: LocalConfig = field(default_factory=lambda: LOCAL)
    graph: GlobalConfig = field(default_factory=lambda: GRAPH)
    max_range: float = 30.0
    clear_range: float = 5.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.map is not None:
            raise ConfigError("cartographer_original only maps; cartographer localizes in a known map")


class CartographerOriginalMapper(CartographerMapper):
    """Cartographer in the plane: no attitude, no monitor."""

    name = "cartographer_original"

    def __init__(self, config: CartographerOriginalConfig | None = None) -> None:
        super().__init__(config or CartographerOriginalConfig())

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Process a scan as if the base were level; return `T_map_base`."""
        return super().process(scan, odometry, None)

    @property
    def lost(self) -> bool:
        """Always False: the original has no monitor."""
        return False
