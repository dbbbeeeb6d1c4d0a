"""Replay of a log in its own simulation: do mappers err alike on both?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.stats import kendalltau

from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.robot_model import CONTROL_PERIOD
from lirs_envs.sensing.odometry import DistanceNoise
from lirs_envs.sensing.sensors import SensorNoise
from lirs_extensions.search.twin.fit import odometry_deviations
from lirs_extensions.search.twin.surface import (
    GATE,
    LOCALIZED,
    WIDTH,
    LogComparison,
    align,
    expected_beams,
    fit_surfaces,
    map_of,
    noisy_ranges,
    scan_arrays,
)
from lirs_validation.config import MapConfig
from lirs_validation.logs.map_log import MappedLog, run_mapping
from lirs_validation.logs.read_log import read_truth, truth_in_time
from lirs_validation.metrics.mapped_log import RelativePoseConstraint, trajectory_accuracy
from lirs_validation.record.metric_catalog import NOTHING
from lirs_validation.report.table import ReportTable
from lirs_wct import FloatArray, LaserScan, Pose2, SourceError, Trajectory, unknown_name
from lirs_wct.drawing.canvas import BLUE, GRAY, Drawing, new_figure, plain_axes, title
from lirs_wct.formats import drive_files
from lirs_wct.progress import Progress
from slam_baselines.mapper import MAPPERS

REPLAYED = (
    "hector", "gmapping", "cartographer", "hector_original", "gmapping_original", "cartographer_original",
)  # fmt: skip
"""Mappers of a replay."""
FACTOR = 2.0
"""Errors within this factor agree."""


def parse_mappers(text: str) -> tuple[str, ...]:
    """Return the mappers of a replay: names with commas, `all` or `none`."""
    if text in ("all", "none"):
        return REPLAYED if text == "all" else ()
    names = tuple(text.split(","))
    for name in names:
        if name not in MAPPERS:
            raise unknown_name("--replay", name, ["all", "none", *MAPPERS])
    return names


@dataclass(frozen=True)
class ReplayedMapper:
    """Errors of a mapper on a log and on its simulation.

    Attributes:
        real: Error on the log, meters; None if nothing can be compared.
        drawn: Errors on the simulated logs, by the same metric.
        status: Statuses of the mappings of the log and of the simulated logs.
        reason: Cause why the mapper was left out; empty otherwise.
    """

    mapper: str
    real: float | None = None
    drawn: tuple[float | None, ...] = ()
    status: tuple[str, ...] = ()
    reason: str = ""

    @property
    def simulated(self) -> float | None:
        """Median error on the simulated logs, meters."""
        known = [error for error in self.drawn if error is not None]
        return median(known) if known else None

    @property
    def ratio(self) -> float | None:
        """Simulated error over the real one."""
        return self.simulated / self.real if self.real and self.simulated else None

    @property
    def agrees(self) -> bool:
        """Whether the errors are within a factor of two."""
        return self.ratio is not None and 1 / FACTOR <= self.ratio <= FACTOR


@dataclass(frozen=True)
class Replay:
    """Errors of mappers on a log and on its simulation.

    Attributes:
        metric: Name of the error.
        odometry: Deviations of distance, relative, and turn, radians, over 5 m by the log's odometry, and
            their medians by the simulated ones; None without odometry, or where the path is too short.
    """

    metric: str
    mappers: tuple[ReplayedMapper, ...]
    odometry: tuple[tuple[float, float], tuple[float, float]] | None = None

    @property
    def pairs(self) -> tuple[ReplayedMapper, ...]:
        """Mappers with both errors."""
        return tuple(m for m in self.mappers if m.ratio is not None)

    @property
    def tau(self) -> float | None:
        """Kendall's tau between the errors on both logs; None where they have no order."""
        if len(self.pairs) < 3:
            return None
        real, simulated = zip(*((m.real, m.simulated) for m in self.pairs), strict=True)
        tau = float(kendalltau(real, simulated).statistic)
        return None if math.isnan(tau) else tau

    @property
    def sentence(self) -> str:
        """Mappers whose verdicts from the simulation can be trusted, in one sentence."""
        near = ", ".join(m.mapper for m in self.pairs if m.agrees)
        far = ", ".join(f"{m.mapper} ({m.ratio:.2g} x the log's)" for m in self.pairs if not m.agrees)
        enough = f"close enough to trust a verdict on {near}: errors agree within a factor of {FACTOR:g}"
        but = f"{'; but not on ' if near else 'not close enough to trust a verdict on '}{far}" if far else ""
        found = f"{enough if near else ''}{but}" or "not yet known to be close enough: no mapper was compared"
        return f"The simulation of this lidar is {found}."

    def figures(self) -> dict[str, Any]:
        """Return all figures, for JSON."""
        rows = [
            {"mapper": m.mapper, "real": m.real, "simulated": list(m.drawn), "ratio": m.ratio,
             "status": list(m.status), "reason": m.reason}
            for m in self.mappers
        ]  # fmt: skip
        names = ("distance", "turn")
        both = self.odometry or ((None, None), (None, None))
        deviations = {n: {"real": a, "simulated": b} for n, a, b in zip(names, *both, strict=True)}
        return {"metric": self.metric, "tau": self.tau, "mappers": rows, "odometry": deviations}


@dataclass(frozen=True)
class TwinPath:
    """A log's path in its map, and the ranges there.

    Attributes:
        scans: Scans of the log with the usual number of beams.
        truth: Poses of the base in the map.
        exact: (n, beams) ranges to the map's walls, meters; inf = no wall.
        objects: (n, beams) ranges as the log has them where it saw what the map lacks, such as people or an
            open door, meters; NaN elsewhere.
        odometry: (n, 3) poses of the base by the log's odometry; None where it holds none.
    """

    scans: tuple[LaserScan, ...]
    truth: Trajectory
    exact: FloatArray
    objects: FloatArray
    odometry: FloatArray | None

    def simulate_log(self, noise: SensorNoise, seed: int) -> list[tuple[LaserScan, Pose2]]:
        """Return the scans and the odometry that simulated sensors record; odometry may be constant."""
        assert isinstance(noise.lidar, LidarNoise)
        drawn = noisy_ranges(self.exact, self.scans[0].range_max, noise.lidar, seed)
        ranges = np.where(np.isnan(self.objects), drawn, self.objects).astype(np.float32)
        scans = [replace(scan, ranges=row) for scan, row in zip(self.scans, ranges, strict=True)]
        odometry = [Pose2()] * len(scans)
        if self.odometry is not None:
            odometry = simulate_odometry(self.truth, noise, seed)
        return list(zip(scans, odometry, strict=True))


def place_log(mapped: MappedLog, usual: Sequence[int], real: LogComparison) -> TwinPath:
    """Match all scans of a log to its map, and cast their rays there."""
    scans = [mapped.log.scans[k] for k in usual]
    odometry = [mapped.log.odometry[k] for k in usual]
    whole = replace(real.scans, block=2 * real.scans.block)  # All blocks are even.
    surfaces, log = fit_surfaces(whole), scan_arrays(scans, mapped.trajectory)
    moved, share = np.empty_like(log.poses), np.empty(len(log.poses))
    align(surfaces, log.ranges, log.angles, log.poses, WIDTH, moved, share)
    localized = (share >= LOCALIZED)[:, None]
    poses = np.where(localized, moved, log.poses)
    for k in range(1, len(poses)):
        if odometry[k] is not None and odometry[k] == odometry[k - 1]:
            poses[k] = poses[k - 1]  # A robot that stands has one pose.
    exact = expected_beams(map_of(whole), surfaces, replace(log, poses=poses)).ranges
    with np.errstate(invalid="ignore"):
        lacking = localized & np.isfinite(log.ranges) & ~(np.abs(log.ranges - exact) <= GATE)
    mounts = (scan.T_base_laser.to_pose2().inverse() for scan in scans)
    truth = [Pose2(*pose) @ mount for pose, mount in zip(poses.tolist(), mounts, strict=True)]
    stamps = [scan.stamp for scan in scans]
    rows = [pose.as_array() for pose in odometry if pose is not None]
    return TwinPath(
        tuple(scans),
        Trajectory.from_poses(stamps, truth),
        exact,
        np.where(lacking, log.ranges, np.nan),
        np.array(rows) if len(rows) == len(scans) else None,
    )


def simulate_odometry(truth: Trajectory, noise: SensorNoise, seed: int) -> list[Pose2]:
    """Return `T_odom_base` by wheels and gyro with `noise` on a path; it rests where the path does."""
    rng = np.random.default_rng(seed)
    wheels, imu = DistanceNoise(noise.odometry, rng), noise.imu
    bias = imu.rate_bias * rng.standard_normal()
    poses = [Pose2()]
    for k, dt in enumerate(np.diff(truth.stamps).tolist(), start=1):
        before, after = truth.pose2(k - 1), truth.pose2(k)
        if before == after:
            poses.append(poses[-1])
            continue
        step = before.inverse() @ after
        distance = float(np.hypot(step.x, step.y))
        scale = wheels.measure(distance) / distance if distance > 0 else 1.0
        # White noise of each update adds up to that of the whole step.
        drift = bias * dt + imu.rate_sigma * np.sqrt(CONTROL_PERIOD * dt) * rng.standard_normal()
        poses.append(poses[-1] @ Pose2(scale * step.x, scale * step.y, step.yaw + float(drift)))
    return poses


def replay_log(
    config: MapConfig,
    path: TwinPath,
    noise: SensorNoise,
    names: Sequence[str],
    draws: int,
    folder: Path,
    progress: Progress,
) -> Replay:
    """Map a log and its simulations by some mappers; return their errors.

    The truth of the log is its relations or its reference; without both it is the path in the map. Each of
    the `draws` simulated logs has another seed; the folder receives them, and their true path.
    """
    drive_files.write_tum(folder / "truth.tum", path.truth)
    paths = [folder / f"simulated-{config.seed + k}.clf.gz" for k in range(draws)]
    logs = [path.simulate_log(noise, config.seed + k) for k in range(draws)]
    for written, log in zip(paths, logs, strict=True):
        drive_files.write_scans(written, log)
    truth = relations, reference = read_truth(config)
    metric = "ATE" if reference else f"ATE to the path of {config.mapper}"
    metric = "mean error of the relations" if relations else metric
    rows = []
    for k, name in enumerate(names):
        progress(f"replay {name}", k / len(names))
        options: dict[str, Any] = {"mapper": name, "seed": config.seed, "second": "none"}
        own: dict[str, Any] = {"mapper_python": None, "parameters": "", "resolution": None, "imu": None}
        plain = replace(config, relations=None, reference=None, **options, **own)
        try:
            real = run_mapping(plain)
            twins = [run_mapping(MapConfig(log=str(written), **options)) for written in paths]
        except SourceError as error:
            rows.append(ReplayedMapper(name, reason=str(error)))
            continue
        given, true = truth_in_time(truth, real.log.lines)
        true = path.truth if true is None else true
        on_path = None if given is None else _relations_on(path.truth, given)
        errors = tuple(_error(twin, on_path, path.truth) for twin in twins)
        status = (real.record.status, *(twin.record.status for twin in twins))
        rows.append(ReplayedMapper(name, _error(real, given, true), errors, status))
    return Replay(metric, tuple(rows), _compare_odometry(path, logs))


def _compare_odometry(
    path: TwinPath, logs: Sequence[Sequence[tuple[LaserScan, Pose2]]]
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return the deviations of the log's odometry and the medians of the simulated ones."""
    poses = path.truth.planar_at(path.truth.stamps)
    real = None if path.odometry is None else odometry_deviations(path.odometry, poses)
    if real is None:
        return None
    drawn = (odometry_deviations(np.array([pose.as_array() for _, pose in log]), poses) for log in logs)
    distance, turn = zip(*(found for found in drawn if found is not None), strict=True)
    return real, (median(distance), median(turn))


def _relations_on(
    truth: Trajectory, relations: Sequence[RelativePoseConstraint]
) -> list[RelativePoseConstraint]:
    """Return relations between the same stamps as they hold on a true path."""
    ends = np.array([(r.stamp_a, r.stamp_b) for r in relations])
    first, last = (truth.planar_at(column).tolist() for column in ends.T)
    pairs = zip(relations, first, last, strict=True)
    return [replace(r, T_ab=Pose2(*a).inverse() @ Pose2(*b)) for r, a, b in pairs]


def _error(
    mapped: MappedLog, relations: Sequence[RelativePoseConstraint] | None, reference: Trajectory | None
) -> float | None:
    """Return a mapper's error, meters: of relations where given, else the ATE."""
    found = trajectory_accuracy(mapped.trajectory, mapped.log.track, relations, reference).metrics()
    kind, name = ("reference", "ate_rmse") if relations is None else ("relations", "translation_mean")
    error: float | None = found[kind][name]
    return error


def replay_figure(replay: Replay) -> Drawing:
    """Draw the mappers' errors on the simulated log over those on the log."""
    figure = new_figure(5.5, 4.5)
    ax = figure.subplots()
    rows = [(m.mapper, m.real, m.simulated) for m in replay.mappers if m.real and m.simulated]
    low = 0.7 * min(min(real, simulated) for _, real, simulated in rows)
    high = 1.4 * max(max(real, simulated) for _, real, simulated in rows)
    line = np.array((low, high))
    ax.fill_between(line, line / FACTOR, line * FACTOR, color=GRAY, alpha=0.25, linewidth=0)
    ax.plot(line, line, color=GRAY, linewidth=1)
    for name, real, simulated in rows:
        ax.plot(real, simulated, "o", color=BLUE)
        ax.annotate(name, (real, simulated), xytext=(5, 4), textcoords="offset points", fontsize=8)
    ax.set_xscale("log")
    ax.set_yscale("log")
    plain_axes(ax, "error on the log, m", "error on the simulated logs, m")
    title(ax, f"{replay.metric}; within a factor of {FACTOR:g}: gray")
    return figure


def replay_table(replay: Replay | None) -> ReportTable:
    """Return the mappers' errors on the log and on its simulation."""
    headings = ("mapper", "log, m", "simulated, m", "ratio", "remark")
    if replay is None:
        return ReportTable("replay", "Mappers", "The replay was not requested.", headings, ())
    rows = []
    for m in replay.mappers:
        lost = sum(status != "ok" for status in m.status[1:])
        remarks = [f"{m.status[0]} on the log"] if m.status and m.status[0] != "ok" else []
        remarks += [f"not ok on {lost} of {len(m.drawn)} simulated logs"] if lost else []
        values = (NOTHING if v is None else f"{v:.3f}" for v in (m.real, m.simulated))
        ratio = NOTHING if m.ratio is None else f"{m.ratio:.2f}"
        rows.append((m.mapper, *values, ratio, m.reason or ", ".join(remarks)))
    caption = (
        f"{replay.metric}; of the simulated logs the median. They have the path and the fitted noise of "
        "the log, and objects that the map lacks as the log saw them."
    )
    return ReportTable("replay", "Mappers", caption, headings, tuple(rows), remarks=True)
