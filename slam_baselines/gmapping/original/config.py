"""Parameters of the original, by its names."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_wct.field_validators import require_above, require_at_least, require_within
from slam_baselines.gmapping.original.hit_maps import MatchingParameters


@dataclass(frozen=True, kw_only=True)
class GmappingOriginalConfig:
    """Parameters of OpenSLAM's GMapping with its defaults.

    Attributes:
        particles: number of paths.
        seed: of the random numbers, as for the C library's `srand48`.
        linearUpdate: meters to drive before the next scan is processed.
        angularUpdate: radians to turn before the next scan is processed.
        resampleThreshold: particles are resampled when N_eff falls below this share of them.
        srr: error of the odometry in translation after one meter, meters.
        srt: error of the odometry in rotation after one meter, radians.
        str: error of the odometry in translation after one radian, meters.
        stt: error of the odometry in rotation after one radian, radians.
        sigma: of the matcher's score, square meters.
        kernelSize: cells around the end of a beam in which the matcher looks for hits.
        lstep: first step of the matcher in x and y, meters.
        astep: first step of the matcher in yaw, radians.
        iterations: how often the steps are halved.
        lsigma: of the likelihood, square meters.
        ogain: likelihoods are taken to the power 1 / (ogain * particles).
        delta: edge of a map's cell, meters.
        maxrange: farther readings are not used, meters. A beam without return reads the lidar's largest
            range, as in a CARMEN log.
        maxUrange: farther readings are no hits, meters: free up to there.
        occ_thresh: share of hits among the beams through a cell above which it is occupied.

    Raises:
        ConfigError: a value that is not legal.
    """

    particles: int = 30
    seed: int = 0
    linearUpdate: float = 1.0  # noqa: N815  the original's names
    angularUpdate: float = 0.5  # noqa: N815
    resampleThreshold: float = 0.5  # noqa: N815
    srr: float = 0.1
    srt: float = 0.2
    str: float = 0.1
    stt: float = 0.2
    sigma: float = 0.05
    kernelSize: int = 1  # noqa: N815
    lstep: float = 0.05
    astep: float = 0.05
    iterations: int = 5
    lsigma: float = 0.075
    ogain: float = 3.0
    delta: float = 0.05
    maxrange: float = 80.0
    maxUrange: float = 80.0  # noqa: N815
    occ_thresh: float = 0.25

    def __post_init__(self) -> None:
        require_above(self, 0, "particles", "sigma", "lstep", "astep", "lsigma", "ogain", "delta")
        require_above(self, 0, "maxrange", "maxUrange", unit="m")
        require_at_least(self, 0, "linearUpdate", "angularUpdate", "srr", "srt", "str", "stt", "kernelSize")
        require_at_least(self, 1, "iterations")
        require_within(self, "[0, 1]", "resampleThreshold")
        require_within(self, "[0, 1)", "occ_thresh")

    @property
    def matching(self) -> MatchingParameters:
        """Parameters of the matcher."""
        return MatchingParameters(
            self.sigma, self.kernelSize, self.lstep, self.astep, self.iterations, self.lsigma
        )
