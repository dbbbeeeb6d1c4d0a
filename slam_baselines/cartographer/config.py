"""Parameters of global SLAM."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lirs_wct.errors import ConfigError
from lirs_wct.validation import require_within
from slam_baselines.cartographer.constraints.builder import ConstraintConfig
from slam_baselines.cartographer.constraints.candidates import CandidateConfig
from slam_baselines.cartographer.constraints.verification import LoopVerificationConfig
from slam_baselines.cartographer.optimization import OptimizationConfig
from slam_baselines.cartographer.submap import SubmapConfig
from slam_baselines.cartographer.trimmer import TrimmingConfig
from slam_baselines.mapping.ground_filter import GroundFilterConfig
from slam_baselines.matching.gauss_newton import MatchConfig
from slam_baselines.matching.registration import RegistrationConfig
from slam_baselines.matching.tracking import TrackingConfig
from slam_baselines.motion.dead_reckoning import MotionConfig
from slam_baselines.motion.motion_filter import MotionFilterConfig

SUBMAP_REGISTRATION = RegistrationConfig(
    match=MatchConfig(exact=True),
    min_walls=15,
    min_gain=0.0,
    search_prior=True,
    coasting=False,
    reject_poor=False,
    mahalanobis_gate=math.inf,
)
"""Registration in a submap: the pose graph corrects what a wrong match of local SLAM costs."""


@dataclass(frozen=True, kw_only=True)
class GlobalConfig:
    """Parameters of global SLAM; names as in Cartographer's pose_graph.

    Attributes:
        candidates: pairs of nodes and submaps that are searched.
        constraints: loop search.
        verification: of loops that move the map far.
        optimization: of the graph.
        trimming: of redundant submaps.
        optimize_every_n_nodes: number of new nodes after which new loops make an optimization due.
        searches_per_update: most loop searches in one update.
        matcher_translation_error: standard deviation of a node's place in a submap that it entered, metres.
        matcher_rotation_error: likewise of its yaw, radians.

    Raises:
        ConfigError: a value that is not above 0.
    """

    candidates: CandidateConfig = field(default_factory=CandidateConfig)
    constraints: ConstraintConfig = field(default_factory=ConstraintConfig)
    verification: LoopVerificationConfig = field(default_factory=LoopVerificationConfig)
    optimization: OptimizationConfig = field(default_factory=OptimizationConfig)
    trimming: TrimmingConfig = field(default_factory=TrimmingConfig)
    optimize_every_n_nodes: int = 40
    searches_per_update: int = 1
    matcher_translation_error: float = 0.03
    matcher_rotation_error: float = 0.01

    def __post_init__(self) -> None:
        if min(self.optimize_every_n_nodes, self.searches_per_update) < 1:
            raise ConfigError("optimize_every_n_nodes and searches_per_update must be at least 1")
        if not (self.matcher_translation_error > 0 and self.matcher_rotation_error > 0):
            raise ConfigError("matcher_translation_error and matcher_rotation_error must be above 0")


@dataclass(frozen=True, kw_only=True)
class LocalConfig:
    """Parameters of local SLAM.

    Attributes:
        submaps: how submaps are drawn.
        motion_filter: which scans enter them.
        motion: confidence in the odometry.
        registration: of a scan in the matching submap.
        ground_filter: separates hits on ground from hits on walls.
        slip_speed: on uneven ground, a match is not believed that lies farther from where odometry puts the
            robot than this allows in the time since the last scan, m/s and rad/s ...
        slip_deviations: ... and so many standard deviations of that prediction.
        tracking: mean occupancy at the ends of the beams below which a scan enters no submap.

    Raises:
        ConfigError: the tracking's lost_score above the registration's search_threshold.
    """

    submaps: SubmapConfig = field(default_factory=SubmapConfig)
    motion_filter: MotionFilterConfig = field(default_factory=MotionFilterConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    registration: RegistrationConfig = SUBMAP_REGISTRATION
    ground_filter: GroundFilterConfig = field(default_factory=GroundFilterConfig)
    slip_speed: float = 1.0
    slip_deviations: float = 4.0
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(lost_score=0.2))

    def __post_init__(self) -> None:
        legal = f"(0, {self.registration.search_threshold}]"
        require_within(self.tracking, legal, "lost_score", of="the tracking")


@dataclass(frozen=True, kw_only=True)
class LocalisationConfig:
    """When a place is believed.

    Attributes:
        min_score: mean occupancy at the ends of the beams that a place found in the whole map needs.
        rival: it is not believed if another place has this share of its score ...
        apart: ... at least so far from it, metres.
        every: while the place is unknown it is searched for after so much distance, metres ...
        seconds: ... or so much time.
        beams: at most so many beams are used to search, evenly spread in space ...
        min_beams: ... and fewer than this say nothing.
        bounded: a search is given up after so many nodes of its tree.
        tracking: mean occupancy at the ends of the beams below which a scan does not fit.
        start: standard deviation of a pose that is given, metres and radians.

    Raises:
        ConfigError: a value that is not above 0, or a share above 1.
    """

    min_score: float = 0.55
    rival: float = 0.9
    apart: float = 1.0
    every: float = 1.0
    seconds: float = 5.0
    beams: int = 150
    min_beams: int = 30
    bounded: int = 1 << 20
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(lost_score=0.2))
    start: tuple[float, float] = (0.3, 0.1)

    def __post_init__(self) -> None:
        for name in set(self.__dataclass_fields__) - {"start", "tracking"}:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the localisation must be above 0, got {getattr(self, name)}")
        if max(self.min_score, self.rival) > 1:
            raise ConfigError("min_score and rival of the localisation must be at most 1")
