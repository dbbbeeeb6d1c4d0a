"""Twin test of a log, and the files of its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.sensing.sensors import SensorNoise, write_noise
from lirs_extensions.search.twin.fit import (
    FittedNoise,
    FittedOdometry,
    Sample,
    fit_noise,
    fit_odometry,
    residual_distance,
)
from lirs_extensions.search.twin.replay import place_log, replay_log
from lirs_extensions.search.twin.result import TwinResult, write_page
from lirs_extensions.search.twin.surface import (
    BLOCK,
    LogComparison,
    compare,
    laser_poses,
    scan_arrays,
    simulate_scans,
)
from lirs_validation.config import MapConfig
from lirs_validation.logs.map_log import MappedLog, run_mapping
from lirs_wct import FloatArray, LaserScan, Pose2, SourceError, Trajectory
from lirs_wct.files import atomic_folder, check_writable, write_json
from lirs_wct.progress import Progress, no_progress

LEAST_BLOCKS = 4
"""Fewest blocks of a log."""
MOST_SCANS = 1500
"""Most scans of a comparison; of longer logs every second, third, ... scan is used."""
STILL, STANDS = 20, (0.01, 0.01, 0.002)
"""Fewest successive scans at standstill, and limit of its motion by the mapper, meters and radians. Shorter
repetitions of a pose may be gaps of the odometry."""


def run_twin(
    config: MapConfig,
    *,
    lidar: str,
    seed: int,
    out: Path,
    replayed: Sequence[str] = (),
    draws: int = 1,
    command: str = "",
    progress: Progress = no_progress,
) -> tuple[TwinResult, Path]:
    """Compare a log with its simulation, fit the noise, and write the result's folder.

    The folder holds twin.html, twin.json, noise.yaml, pictures, and the simulated logs of a replay.

    Args:
        config: Configuration of the mapping; its relations or its reference are the truth of a replay.
        lidar: name of the preset whose data sheet the log is compared with.
        seed: Seed of the simulated noise and the bootstrap.
        out: folder that receives the result's folder.
        replayed: mappers of the replay.
        draws: count of simulated logs of the replay.
        command: command line, for the page.
        progress: Function that receives step and share.

    Raises:
        WctError: the log cannot be used or mapped, or the result cannot be written.
    """
    make_lidar_preset(lidar)
    check_writable(out)
    mapped = run_mapping(replace(config, second="none"), progress=progress)
    if mapped.record.status != "ok":
        raise SourceError(f"{config.log}: {config.mapper} lost its place ({mapped.record.reason})")
    usual = _usual_scans(config.log, mapped.log.scans)
    result = _compare_and_fit(config, mapped, usual, lidar, seed, progress)
    folder = out / f"{mapped.record.name}-twin"
    with atomic_folder(folder) as temporary:
        if replayed:
            path = place_log(mapped, usual, result.real)
            found = replay_log(config, path, result.noise, replayed, draws, temporary, progress)
            result = replace(result, replay=found)
        write_json(temporary / "twin.json", result.figures())
        write_noise(temporary / "noise.yaml", result.noise, f"fitted to {result.name}")
        write_page(temporary, result, command)
    return result, folder


def _compare_and_fit(
    config: MapConfig, mapped: MappedLog, usual: Sequence[int], lidar: str, seed: int, progress: Progress
) -> TwinResult:
    """Compare the log's scans with its map, and fit noise and odometry."""
    kept = usual[:: -(-len(usual) // MOST_SCANS)]
    scans = [mapped.log.scans[k] for k in kept]
    log = scan_arrays(scans, mapped.trajectory)
    if log.block.max() < LEAST_BLOCKS:
        raise SourceError(
            f"{config.log}: its path must be at least {LEAST_BLOCKS * BLOCK:g} m long for a comparison, "
            f"got {mapped.trajectory.length:.1f} m"
        )
    progress("compare", 0.1)
    real = compare(log)
    progress("fit", 0.3)
    try:
        fitted = fit_noise(real, log.poses, seed)
    except SourceError as error:
        raise SourceError(f"{config.log}: {error}") from error
    progress("fit", 0.8)
    odometry = [mapped.log.odometry[k] for k in kept]
    wheels = _fit_wheels(scans, odometry, real, fitted, seed)
    path = mapped.trajectory.planar_at(np.array([scan.stamp for scan in mapped.log.scans]))
    still = standstill(mapped.log.scans, mapped.log.odometry, path)
    result = TwinResult(mapped.record.name, lidar, real, fitted, 1.0, wheels, still, len(mapped.log.scans))
    before = Sample.of(compare(simulate_scans(real, log.poses, result.sheet, seed)))
    return replace(result, distance_before=residual_distance(fitted.real, before))


def _fit_wheels(
    scans: Sequence[LaserScan],
    odometry: Sequence[Pose2 | None],
    real: LogComparison,
    fitted: FittedNoise,
    seed: int,
) -> FittedOdometry | None:
    """Return the errors of the scans' odometry; None if a scan has none."""
    known = [pose for pose in odometry if pose is not None]
    if len(known) < len(scans):
        return None
    stamps = np.array([scan.stamp for scan in scans])
    measured = laser_poses(Trajectory.from_poses(stamps, known), scans)
    length = SensorNoise().odometry.scale_length
    return fit_odometry(measured, real.scans.poses, stamps, fitted.poses, length, seed)


def _usual_scans(path: str, scans: Sequence[LaserScan]) -> list[int]:
    """Return the scans with the usual number of beams."""
    if not scans:
        raise SourceError(f"{path}: needs planar scans, got none")
    beams = int(np.bincount([len(scan.ranges) for scan in scans]).argmax())
    return [k for k, scan in enumerate(scans) if len(scan.ranges) == beams]


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
