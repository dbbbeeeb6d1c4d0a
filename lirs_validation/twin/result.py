"""Result of a twin test, and its figures."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lirs_envs.lidar.presets import LidarNoise, lidar_noise, make_lidar_preset
from lirs_envs.sensing.sensors import SensorNoise
from lirs_validation.twin.compare import CLUSTER, GATE, LogComparison
from lirs_validation.twin.fit import FittedNoise, FittedOdometry, curve
from lirs_validation.twin.replay import Replay
from lirs_wct.arrays import BoolArray


@dataclass(frozen=True)
class TwinResult:
    """Result of a twin test.

    Attributes:
        name: of the log's folder.
        lidar: preset whose data sheet the log is compared with.
        real: comparison of the log's odd blocks with the map of its even blocks.
        fitted: noise of the lidar.
        distance_before: Kolmogorov distance of a simulation with the data sheet's noise.
        odometry: errors of the odometry; None where the log has none, or is too short.
        standstill: median deviation of a beam while the robot stands, meters; None = it never does.
        total: scans of the log.
        replay: errors of mappers on the log and on its simulation; None = not requested.
    """

    name: str
    lidar: str
    real: LogComparison
    fitted: FittedNoise
    distance_before: float
    odometry: FittedOdometry | None
    standstill: float | None
    total: int
    replay: Replay | None = None

    @property
    def sheet(self) -> LidarNoise:
        """Noise of the lidar's data sheet, with the log's steps."""
        sheet = lidar_noise(make_lidar_preset(self.lidar), "datasheet")
        return replace(sheet, quantization=self.fitted.noise.quantization)

    @property
    def noise(self) -> SensorNoise:
        """Noise of all sensors; those that were not fitted have the defaults."""
        made = SensorNoise(lidar=self.fitted.noise)
        if self.odometry is None:
            return made
        sigma, constant = self.odometry.scale_sigma[0], self.odometry.scale
        wheels = replace(made.odometry, scale_sigma=sigma, scale_bias=constant)
        rates = {"rate_sigma": self.odometry.rate_sigma[0], "rate_bias": self.odometry.rate_bias}
        return replace(made, odometry=wheels, imu=replace(made.imu, **rates))

    @property
    def sentences(self) -> tuple[str, ...]:
        """The result in a sentence each: noise, distributions, mappers."""
        at = float(np.median(self.fitted.real.ranges))
        ours, theirs = (1000 * (n.sigma + n.sigma_relative * at) for n in (self.fitted.noise, self.sheet))
        return (
            f"At {at:.1f} m this lidar's noise is {ours:.1f} mm, that of {self.lidar} {theirs:.1f} mm.",
            "The Kolmogorov distance between real and simulated residuals is "
            f"{self.fitted.distance:.2f} with noise.yaml and {self.distance_before:.2f} with {self.lidar}.",
            *(() if self.replay is None else (self.replay.sentence,)),
        )

    def figures(self) -> dict[str, Any]:
        """Return all figures, for JSON."""
        f, sample = self.fitted, self.fitted.real
        lost, mixed = sample.shares(sample.blocks).tolist()
        lost_simulated, mixed_simulated = f.simulated.shares(f.simulated.blocks).tolist()
        return {
            "log": self.name,
            "lidar": self.lidar,
            "sentences": list(self.sentences),
            "scans": {"log": self.total, **_scan_counts(self.real)},
            "beams": _beam_shares(self.real),
            "noise": {"fitted": asdict(f.noise), "low": asdict(f.low), "high": asdict(f.high)},
            "kolmogorov": {"before": self.distance_before, "after": f.distance},
            "lost": {"real": lost, "simulated": lost_simulated},
            "mixed_pixels": {"real": mixed, "simulated": mixed_simulated},
            "map_width": [None if math.isnan(width) else width for width in f.map_width.tolist()],
            "map_share": _map_share(f),
            "by_range": {"real": curve(sample), "simulated": curve(f.simulated)},
            "by_incidence": _by_incidence(self.real),
            "standstill": self.standstill,
            "odometry": None if self.odometry is None else asdict(self.odometry),
            "replay": None if self.replay is None else self.replay.figures(),
        }


def _scan_counts(real: LogComparison) -> dict[str, int]:
    """Return the counts of scans in the comparison."""
    used, odd = int(real.used.sum()), int((~real.scans.even).sum())
    return {"used": len(real.used), "odd blocks": odd, "localized": used}


def _beam_shares(real: LogComparison) -> dict[str, float]:
    """Return shares of the odd blocks' beams.

    They are compared, on objects that the map lacks, single and too near, or beyond its walls.
    """
    hits = np.isfinite(real.scans.ranges) & real.used[:, None]
    compared = real.compared & np.isfinite(real.residual)
    near = compared & (real.residual < -GATE)
    total = max(int(compared.sum()), 1)
    return {
        "compared": int(compared.sum()) / max(int(hits.sum()), 1),
        "on objects": int(_clusters(near).sum()) / total,
        "too near alone": int((near & ~_clusters(near)).sum()) / total,
        "beyond walls": int((compared & (real.residual > GATE)).sum()) / total,
    }


def _clusters(found: BoolArray) -> BoolArray:
    """Return (n, beams) members of runs of at least `CLUSTER` neighboring beams."""
    begins = np.ones_like(found[:, : 1 - CLUSTER])
    for k in range(CLUSTER):
        begins &= found[:, k : found.shape[1] - CLUSTER + 1 + k]
    members = np.zeros_like(found)
    for k in range(CLUSTER):
        members[:, k : found.shape[1] - CLUSTER + 1 + k] |= begins
    return members


def _by_incidence(real: LogComparison) -> list[dict[str, float]]:
    """Return count, bias and width of the residuals by incidence, degrees."""
    residual, _, cosine, _ = real.residuals()
    angle, rows = np.degrees(np.arccos(np.minimum(cosine, 1.0))), []
    for low, high in ((0, 15), (15, 30), (30, 45), (45, 60), (60, 70)):
        found = residual[(angle >= low) & (angle < high)]
        if len(found):
            low_, bias, high_ = np.quantile(found, (0.1587, 0.5, 0.8413)).tolist()
            rows.append(
                {"from": low, "to": high, "beams": len(found), "bias": bias, "width": (high_ - low_) / 2}
            )
    return rows


def _map_share(fitted: FittedNoise) -> float:
    """Return the share of the residuals' variance that the map explains, over the bins' beams."""
    wide = fitted.real.widths(fitted.real.blocks)
    known = np.isfinite(wide) & np.isfinite(fitted.map_width)
    return float(np.sum(fitted.map_width[known] ** 2) / np.sum(wide[known] ** 2))
