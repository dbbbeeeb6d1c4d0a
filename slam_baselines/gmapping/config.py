"""Parameters of gmapping."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lirs_wct.checks import limited
from slam_baselines.dead_reckoning import MotionConfig
from slam_baselines.front_end import BootstrapConfig
from slam_baselines.gmapping.increment import GyroBiasConfig
from slam_baselines.gmapping.proposal import ProposalConfig
from slam_baselines.ground_filter import GroundFilterConfig
from slam_baselines.leveling import InterpolationConfig
from slam_baselines.monitors import LocalizabilityConfig, TrackingConfig


@dataclass(frozen=True, kw_only=True)
class GmappingConfig(ProposalConfig):
    """Parameters, under gmapping's names where they exist.

    Attributes:
        particles: number of paths.
        seed: of the random numbers.
        linearUpdate: meters to drive before the next scan is processed.
        angularUpdate: radians to turn before the next scan is processed.
        resampleThreshold: particles are resampled when N_eff falls below this share of them.
        srr: error of the odometry in translation after one meter, meters.
        srt: error of the odometry in rotation after one meter, radians, as the original's code reads it.
        str: error of the odometry in translation after one radian, meters; ROS's wiki exchanges the two.
        stt: error of the odometry in rotation after one radian, radians.
        ogain: likelihoods are taken to the power 1 / (ogain * particles), so that single scans with
            their correlated beams do not decide alone.
        delta: edge of a map's cell, meters.
        maxUrange: range from which on hits count as free up to here, meters; infinite: beams without return
            are left out.
        sparse_distance: mean distance between scans, a radian of turn counted as a meter, from which on they
            are matched by the wider search, and their hits are interpolated, meters.
        sparse_memory: scans over which this mean is taken.
        interpolation: of hits along surfaces.
        tracking: share of the beams on known cells that end at a wall, below which a processed scan does not
            enter the maps.
        localizability: conditions for using scans on uneven ground; its scores are hit ratios.
        bootstrap: when the first meters on uneven ground are refined.
        ground_filter: separates hits on ground from hits on walls.
        mahalanobis_gate: largest Mahalanobis distance from dead reckoning at which a match corrects it. On
            slopes wheels slide by up to four standard deviations.
        gyro_bias: the gyro's errors by its data sheet, and parameters of the bias filter.
    """

    particles: int = limited(30, "(0, inf]")
    seed: int = 0
    linearUpdate: float = limited(1.0, "[0, inf]")  # noqa: N815  the original's names
    angularUpdate: float = limited(0.5, "[0, inf]")  # noqa: N815
    resampleThreshold: float = limited(0.5, "[0, 1]")  # noqa: N815
    srr: float = limited(0.05, "(0, inf]")
    srt: float = limited(0.05, "(0, inf]")
    str: float = limited(0.05, "(0, inf]")
    stt: float = limited(0.1, "(0, inf]")
    ogain: float = limited(0.5, "(0, inf]")
    delta: float = limited(0.05, "(0, inf]")
    maxUrange: float = limited(math.inf, "(0, inf]")  # noqa: N815
    sparse_distance: float = limited(0.4, "(0, inf]")
    sparse_memory: float = limited(10.0, "(0, inf]")
    interpolation: InterpolationConfig = field(default_factory=InterpolationConfig)
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(lost_score=0.3, lost_after=3))
    localizability: LocalizabilityConfig = field(
        default_factory=lambda: LocalizabilityConfig(score=0.75, memory=10.0)
    )
    bootstrap: BootstrapConfig = field(default_factory=lambda: BootstrapConfig(first=2.0))
    ground_filter: GroundFilterConfig = field(default_factory=GroundFilterConfig)
    mahalanobis_gate: float = limited(8.0, "(0, inf]")
    gyro_bias: GyroBiasConfig = field(default_factory=GyroBiasConfig)

    @property
    def motion(self) -> MotionConfig:
        """The odometry's errors for dead reckoning."""
        return MotionConfig(
            translation_per_meter=self.srr,
            translation_per_radian=self.str,
            rotation_per_meter=self.srt,
            rotation_per_radian=self.stt,
        )
