"""Parameters of gmapping."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lirs_wct.errors import limited, require_within
from slam_baselines.dead_reckoning import MotionConfig
from slam_baselines.front_end import FrontEndConfig
from slam_baselines.gmapping.motion import GyroBiasConfig


@dataclass(frozen=True, kw_only=True)
class GmappingConfig(FrontEndConfig, GyroBiasConfig, of="gmapping"):
    """Parameters, under gmapping's names where they exist; scores of the monitors are hit ratios.

    Attributes:
        particles: Number of paths.
        seed: Seed of the random numbers.
        linearUpdate: Distance to drive before the next scan is processed, meters.
        angularUpdate: Angle to turn before the next scan is processed, radians.
        resampleThreshold: Share of the particles below which N_eff lets them be resampled.
        srr: Error of the odometry in translation after one meter, meters.
        srt: Error of the odometry in rotation after one meter, radians, as the original's code reads it.
        str: Error of the odometry in translation after one radian, meters; ROS's wiki exchanges the two.
        stt: Error of the odometry in rotation after one radian, radians.
        ogain: Likelihoods are taken to the power 1 / (ogain * particles), so that single scans with
            their correlated beams do not decide alone.
        delta: Edge of a map's cell, meters.
        maxUrange: Range from which on hits count as free up to here, meters; infinite: beams without return
            are left out.
        sparse_distance: Mean distance between scans, a radian of turn counted as a meter, from which on they
            are matched by the wider search, and their hits are interpolated, meters.
        sparse_memory: Number of scans over which this mean is taken.
        mahalanobis_gate: Largest Mahalanobis distance from dead reckoning at which a match corrects it. On
            slopes wheels slide by up to four standard deviations.
        sigma: Standard deviation of a beam's end while matching, meters.
        kernelSize: Cells looked at to each side of a beam's end.
        iterations: Most Gauss-Newton steps, of the coarse and of the fine stage.
        lsigma: Square of the distance in the likelihood exp(-d^2 / lsigma) of one beam, square meters. Far
            above a laser's variance, since neighboring beams err together.
        lstep: Step of the wider search in x and y, and edge of the cells of its map, meters.
        astep: Step of the wider search in yaw, radians.
        llsamplerange: Half the wider search's window, meters.
        lasamplerange: Half the wider search's window, radians.
        samples: Points evaluated around the maximum.
        spread: Largest distance of these points from the maximum, standard deviations.
        search_threshold: Hit ratio below which the wider search begins.
        minimumScore: Hit ratio below which the match has failed and the odometry alone counts.
        min_beams: Fewest beams at walls for a match.

    Raises:
        ConfigError: a value is not legal, or minimumScore is above search_threshold.
    """

    lost_score: float = limited(0.3, "(0, 1]")
    lost_after: int = limited(3, "[1, inf]")
    localizable_score: float = limited(0.75, "(0, 1)")
    localizable_memory: float = limited(10.0, "[1, inf]")
    localizable_meters: float = limited(5.0, "(0, inf]")
    first_meters: float = limited(0.5, "(0, inf]")
    bootstrap_first: float = limited(2.0, "(0, inf]", "m")
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
    mahalanobis_gate: float = limited(8.0, "(0, inf]")
    sigma: float = limited(0.05, "(0, inf]")
    kernelSize: int = limited(1, "(0, inf]")  # noqa: N815
    iterations: int = limited(8, "(0, inf]")
    lsigma: float = limited(0.005, "(0, inf]")
    lstep: float = limited(0.1, "(0, inf]")
    astep: float = limited(0.02, "(0, inf]")
    llsamplerange: float = limited(0.7, "(0, inf]")
    lasamplerange: float = limited(0.5, "(0, inf]")
    samples: int = limited(16, "(0, inf]")
    spread: float = limited(2.0, "(0, inf]")
    search_threshold: float = limited(0.5, "(0, inf]")
    minimumScore: float = limited(0.15, "(0, inf]")  # noqa: N815
    min_beams: int = limited(15, "(0, inf]")

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, f"(0, {self.search_threshold}]", "minimumScore")

    @property
    def motion(self) -> MotionConfig:
        """Errors of the odometry for dead reckoning."""
        return MotionConfig(
            translation_per_meter=self.srr,
            translation_per_radian=self.str,
            rotation_per_meter=self.srt,
            rotation_per_radian=self.stt,
        )
