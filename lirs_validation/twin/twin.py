"""Twin test of a log, and the files of its result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lirs_envs.lidar.noise import lidar_noise
from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.sensing.sensors import SensorNoise, write_noise
from lirs_validation.config import MapConfig
from lirs_validation.logs.map_log import run_mapping
from lirs_validation.twin.compare import (
    BLOCK,
    CLUSTER,
    GATE,
    LogComparison,
    blocks_of,
    compare,
    simulate_scans,
)
from lirs_validation.twin.fit import (
    FittedNoise,
    FittedOdometry,
    Sample,
    curve,
    fit_noise,
    fit_odometry,
    residual_distance,
)
from lirs_validation.twin.surface import LogScans
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.drawing.style import BLUE, VERMILLION, Drawing, new_figure, plain_axes, title
from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_folder, write_json
from lirs_wct.geometry import LaserScan, Pose2, Trajectory
from lirs_wct.progress import Progress, no_progress

LEAST_BLOCKS = 4
"""Fewest blocks of a log."""
MOST_SCANS = 1500
"""Most scans of a comparison; of longer logs every second, third, ... scan is used."""
LIMIT = 0.1
"""Largest residual that the picture shows, meters."""
STILL, STANDS = 20, (0.01, 0.01, 0.002)
"""Fewest successive scans at standstill, and limit of its motion by the mapper, meters and radians. Shorter
repetitions of a pose may be gaps of the odometry."""


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
    """

    name: str
    lidar: str
    real: LogComparison
    fitted: FittedNoise
    distance_before: float
    odometry: FittedOdometry | None
    standstill: float | None
    total: int

    @property
    def noise(self) -> SensorNoise:
        """Noise of all sensors; those that were not fitted have the defaults."""
        made = SensorNoise(lidar=self.fitted.noise)
        if self.odometry is None:
            return made
        wheels = replace(made.odometry, scale_sigma=self.odometry.scale_sigma[0])
        rates = {"rate_sigma": self.odometry.rate_sigma[0], "rate_bias": self.odometry.rate_bias}
        return replace(made, odometry=wheels, imu=replace(made.imu, **rates))

    @property
    def sentence(self) -> str:
        """The result in one sentence or two."""
        fitted, sheet = self.fitted.noise, lidar_noise(make_lidar_preset(self.lidar), "datasheet")
        at = float(np.median(self.fitted.real.ranges))
        ours, theirs = (n.sigma + n.sigma_relative * at for n in (fitted, sheet))
        return (
            f"At {at:.1f} m this lidar's noise is {1000 * ours:.1f} mm, that of {self.lidar} "
            f"{1000 * theirs:.1f} mm. The Kolmogorov distance between real and simulated residuals is "
            f"{self.fitted.distance:.2f} with noise.yaml and {self.distance_before:.2f} with {self.lidar}."
        )

    def figures(self) -> dict[str, Any]:
        """Return all figures, for JSON."""
        f, sample = self.fitted, self.fitted.real
        lost, mixed = sample.shares(sample.blocks).tolist()
        lost_simulated, mixed_simulated = f.simulated.shares(f.simulated.blocks).tolist()
        return {
            "log": self.name,
            "lidar": self.lidar,
            "sentence": self.sentence,
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
        }


def run_twin(
    config: MapConfig, *, lidar: str, seed: int, out: Path, progress: Progress = no_progress
) -> tuple[TwinResult, Path]:
    """Compare a log with its simulation, fit the noise, and write the result's folder.

    The folder holds twin.json, noise.yaml and residuals.png.

    Args:
        config: of the mapping.
        lidar: name of the preset whose data sheet the log is compared with.
        seed: of the simulated noise and the bootstrap.
        out: folder that receives the result's folder.
        progress: of mapping and simulations.

    Raises:
        WctError: the log cannot be used or mapped, or the result cannot be written.
    """
    preset = make_lidar_preset(lidar)
    mapped = run_mapping(replace(config, second="none"), progress=progress)
    if mapped.record.status != "ok":
        raise SourceError(f"{config.log}: {config.mapper} lost its place ({mapped.record.reason})")
    kept = _usual_scans(config.log, mapped.log.scans)
    scans = [mapped.log.scans[k] for k in kept]
    odometry = [mapped.log.odometry[k] for k in kept]
    stamps = np.array([scan.stamp for scan in scans])
    log = _as_arrays(scans, mapped.trajectory)
    if log.block.max() < LEAST_BLOCKS:
        raise SourceError(f"{config.log}: must be at least {LEAST_BLOCKS * BLOCK:g} m long for a comparison")
    progress("compare", 0.1)
    real = compare(log)
    progress("fit", 0.3)
    try:
        fitted = fit_noise(real, log.poses, seed)
    except SourceError as error:
        raise SourceError(f"{config.log}: {error}") from error
    progress("fit", 0.8)
    sheet = replace(lidar_noise(preset, "datasheet"), quantization=fitted.noise.quantization)
    before = Sample.of(compare(simulate_scans(real, log.poses, sheet, seed)))
    wheels = None
    if all(pose is not None for pose in odometry):
        base = Trajectory.from_poses(stamps, [pose for pose in odometry if pose is not None])
        length = SensorNoise().odometry.scale_length
        measured = _laser_poses(base, scans)
        wheels = fit_odometry(measured, real.scans.poses, stamps, fitted.poses, length, seed)
    path = mapped.trajectory.planar_at(np.array([scan.stamp for scan in mapped.log.scans]))
    still = standstill(mapped.log.scans, mapped.log.odometry, path)
    distance = residual_distance(fitted.real, before)
    name = f"{mapped.record.name}-twin"
    result = TwinResult(name, lidar, real, fitted, distance, wheels, still, len(mapped.log.scans))
    return result, write_twin(out / name, result)


def write_twin(folder: Path, result: TwinResult) -> Path:
    """Write the folder of a result atomically; return it.

    Raises:
        OutputError: the folder cannot be written.
    """
    with atomic_folder(folder) as temporary:
        write_json(temporary / "twin.json", result.figures())
        write_noise(temporary / "noise.yaml", result.noise, f"fitted to {result.name}")
        residual_figure(result.fitted).savefig(temporary / "residuals.png")
    return folder


def _usual_scans(path: str, scans: Sequence[LaserScan]) -> list[int]:
    """Return the scans with the usual number of beams, thinned to `MOST_SCANS`.

    Raises:
        SourceError: there are no scans.
    """
    if not scans:
        raise SourceError(f"{path}: needs planar scans, got none")
    beams = int(np.bincount([len(scan.ranges) for scan in scans]).argmax())
    usual = [k for k, scan in enumerate(scans) if len(scan.ranges) == beams]
    return usual[:: -(-len(usual) // MOST_SCANS)]


def _as_arrays(scans: Sequence[LaserScan], trajectory: Trajectory) -> LogScans:
    """Return scans of one laser as arrays, at the mapper's poses."""
    stamps = np.array([scan.stamp for scan in scans])
    x, y, yaw = trajectory.planar_at(stamps).T
    base = Trajectory.from_poses(stamps, map(Pose2, x.tolist(), y.tolist(), yaw.tolist()))
    poses = _laser_poses(base, scans)
    ranges = np.stack([np.where(scan.hits, scan.ranges.astype(np.float64), np.inf) for scan in scans])
    reach = max(scan.range_max for scan in scans)
    return LogScans(ranges, scans[0].angles, poses, blocks_of(poses), reach)


def _laser_poses(base: Trajectory, scans: Sequence[LaserScan]) -> FloatArray:
    """Return (n, 3) planar poses of the laser from those of the base."""
    mounts = (Pose2(s.T_base_laser.x, s.T_base_laser.y, s.T_base_laser.yaw) for s in scans)
    return np.array([(base.pose2(k) @ mount).as_array() for k, mount in enumerate(mounts)])


def standstill(
    scans: Sequence[LaserScan], odometry: Sequence[Pose2 | None], poses: FloatArray
) -> float | None:
    """Return the median deviation of a beam's ranges while the robot stands still, meters.

    None if it never does for `STILL` scans, by the odometry and by the mapper's `poses` (n, 3).
    """
    groups: list[list[int]] = []
    for k, (scan, pose) in enumerate(zip(scans, odometry, strict=True)):
        same = k > 0 and pose is not None and pose == odometry[k - 1]
        if not same or len(scan.ranges) != len(scans[k - 1].ranges):
            groups.append([])
        groups[-1].append(k)
    found = [np.zeros(0)]
    for group in groups:
        if len(group) >= STILL and (np.ptp(poses[group], axis=0) < STANDS).all():
            ranges = np.stack([np.where(scans[k].hits, scans[k].ranges, np.nan) for k in group])
            deviation = ranges.std(axis=0, ddof=1)
            found.append(deviation[np.isfinite(deviation)])
    values = np.concatenate(found)
    return float(np.median(values)) if len(values) else None


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


def residual_figure(fitted: FittedNoise) -> Drawing:
    """Draw the residuals' width over the range, and their distributions."""
    figure = new_figure(9.0, 3.6)
    width, distribution = figure.subplots(1, 2)
    both = (("log", fitted.real, BLUE), ("simulated with noise.yaml", fitted.simulated, VERMILLION))
    bins = np.linspace(-LIMIT, LIMIT, 101)
    for name, sample, color in both:
        rows = curve(sample)
        ranges = [row["range"] for row in rows]
        width.plot(ranges, [1000 * row["width"] for row in rows], "o-", color=color, label=name)
        width.plot(ranges, [1000 * row["bias"] for row in rows], "o:", color=color, markersize=3)
        distribution.hist(
            sample.residual, bins=bins.tolist(), density=True, histtype="step", color=color, label=name
        )
    width.set_ylim(bottom=min(0.0, width.get_ylim()[0]))
    plain_axes(width, "expected range, m", "residuals, mm")
    plain_axes(distribution, "measured less expected range, m", "density, 1/m")
    title(width, "Half the central 68 % (solid), median (dotted)")
    title(distribution, f"Distance of the distributions: {fitted.distance:.3f}")
    width.legend(frameon=False, fontsize=8)
    return figure
