"""Parameters of local SLAM."""

from __future__ import annotations

from dataclasses import dataclass, field

from lirs_wct.errors import ConfigError
from slam_baselines.local_matching import LocalMatchingConfig
from slam_baselines.motion_filter import MotionFilterConfig
from slam_baselines.odometry import MotionConfig
from slam_baselines.relief import ReliefConfig
from slam_baselines.submap import SubmapConfig


@dataclass(frozen=True, kw_only=True)
class LocalConfig:
    """Parameters of local SLAM.

    Attributes:
        submaps: how submaps are drawn.
        motion_filter: which scans enter them.
        motion: confidence in the odometry.
        matching: how a scan is fitted into a submap.
        relief: how ground is told from walls.
        slip_speed: on uneven ground, a match is not believed that lies farther from where odometry puts the
            robot than this allows in the time since the last scan, m/s and rad/s ...
        slip_deviations: ... and so many standard deviations of that prediction.
        lost_score: mean occupancy at the ends of the beams below which a scan enters no submap ...
        lost_after: ... and after so many of them in a row the mapper is lost.

    Raises:
        ConfigError: lost_score above the matching's poor_score.
    """

    submaps: SubmapConfig = field(default_factory=SubmapConfig)
    motion_filter: MotionFilterConfig = field(default_factory=MotionFilterConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    matching: LocalMatchingConfig = field(default_factory=LocalMatchingConfig)
    relief: ReliefConfig = field(default_factory=ReliefConfig)
    slip_speed: float = 1.0
    slip_deviations: float = 4.0
    lost_score: float = 0.2
    lost_after: int = 10

    def __post_init__(self) -> None:
        if not 0 < self.lost_score <= self.matching.poor_score:
            raise ConfigError(
                f"lost_score must be above 0 and at most poor_score = {self.matching.poor_score}, "
                f"got {self.lost_score}"
            )
