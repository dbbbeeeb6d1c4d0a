"""Replay of a log in its own simulation: do mappers err alike on both?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.robot_model import CONTROL_PERIOD
from lirs_envs.sensing.odometry import DistanceNoise
from lirs_envs.sensing.sensors import SensorNoise
from lirs_extensions.search.case_search import process_pool
from lirs_extensions.search.twin.fit import odometry_deviations
from lirs_extensions.search.twin.surface import (
    GATE,
    LOCALIZED,
    WIDTH,
    LogComparison,
    align,
    blocks_of,
    expected_beams,
    fit_surfaces,
    map_of,
    noisy_ranges,
    scan_arrays,
)
from lirs_validation.config import MapConfig
from lirs_validation.logs.map_log import MappedLog, run_mapping
from lirs_validation.logs.read_log import Truth
from lirs_validation.metrics.mapped_log import RelativePoseConstraint, trajectory_accuracy
from lirs_validation.metrics.trajectory import ErrorSpread
from lirs_validation.record.metric_catalog import NOTHING
from lirs_validation.report.table import ReportTable
from lirs_validation.sweep.engines import Failure, Job, WorkerPool
from lirs_wct import (
    FloatArray,
    IntArray,
    LaserScan,
    Pose2,
    Progress,
    SourceError,
    Trajectory,
    no_progress,
    unknown_name,
)
from lirs_wct.drawing.canvas import BLUE, GRAY, VERMILLION, Drawing, new_figure, plain_axes, title
from lirs_wct.formats import drive_files
from slam_baselines.mapper import MAPPERS

OWN: dict[str, Any] = {"mapper_python": None, "parameters": "", "resolution": None}
"""Options that count for the mapper of the config alone, and their values for others."""


def parse_mappers(text: str) -> tuple[str, ...]:
    """Return the mappers of a replay: names with commas, `all` or `none`."""
    if text in ("all", "none"):
        return tuple(MAPPERS) if text == "all" else ()
    names = tuple(text.split(","))
    for name in names:
        if name not in MAPPERS:
            raise unknown_name("--replay", name, ["all", "none", *MAPPERS])
    return names


@dataclass(frozen=True)
class ReplayedMapper:
    """Errors of a mapper on a log and on its simulations.

    Attributes:
        real: Error on the log, meters; None without truth, or if nothing can be compared.
        drawn: Errors on the simulated logs, by the same metric.
        status: Statuses of the mappings of the simulated logs, and of the log if it was mapped.
        reason: Cause why the mapper was left out; empty otherwise.
    """

    mapper: str
    real: float | None = None
    drawn: tuple[float | None, ...] = ()
    status: tuple[str, ...] = ()
    reason: str = ""

    @property
    def spread(self) -> ErrorSpread | None:
        """Interval of the errors on the simulated logs; None without any."""
        return ErrorSpread.of(self.drawn)

    @property
    def inside(self) -> bool | None:
        """Whether the log's error lies in the interval; None where one is unknown."""
        spread = self.spread
        return None if spread is None or self.real is None else spread.low <= self.real <= spread.high

    def sentence(self, metric: str) -> str:
        """Return the interval, and the error on the log where it is known."""
        spread = self.spread
        if spread is None:
            return f"{self.mapper} has no error in the simulation: {self.reason or 'nothing is comparable'}."
        place = "inside" if self.inside else "outside"
        real = "" if self.real is None else f"; on the log it is {self.real:.3f} m: {place}"
        return (
            f"On this log's noise, {self.mapper}'s {metric} is between {spread.low:.3f} and "
            f"{spread.high:.3f} m in {spread.count} draws{real}."
        )


@dataclass(frozen=True)
class Replay:
    """Errors of mappers on a log and on its simulations.

    Attributes:
        metric: Name of the error.
        odometry: Deviations of distance, relative, and turn, radians, over 5 m by the log's odometry, and
            their medians by the simulated ones; None without odometry, or where the path is too short.
    """

    metric: str
    mappers: tuple[ReplayedMapper, ...]
    odometry: tuple[tuple[float, float], tuple[float, float]] | None = None

    @property
    def sentences(self) -> tuple[str, ...]:
        """Interval of each mapper."""
        return tuple(mapper.sentence(self.metric) for mapper in self.mappers)

    def figures(self) -> dict[str, Any]:
        """Return all figures, for JSON."""
        rows = [
            {"mapper": m.mapper, "real": m.real, "simulated": list(m.drawn), "inside": m.inside,
             "interval": m.spread and asdict(m.spread), "status": list(m.status), "reason": m.reason}
            for m in self.mappers
        ]  # fmt: skip
        names = ("distance", "turn")
        both = self.odometry or ((None, None), (None, None))
        deviations = {n: {"real": a, "simulated": b} for n, a, b in zip(names, *both, strict=True)}
        return {"metric": self.metric, "mappers": rows, "odometry": deviations}


@dataclass(frozen=True)
class TwinPath:
    """A log's path in its map, and the ranges there.

    Attributes:
        scans: Scans of the log with the usual number of beams.
        truth: Poses of the base in the map.
        exact: (n, beams) ranges to the map's walls, meters; inf = no wall.
        objects: (n, beams) ranges as the log has them where it saw what the map lacks, such as people or an
            open door, meters; NaN elsewhere.
        residual: (n, beams) measured less expected ranges elsewhere, meters; NaN where they are unknown.
        odometry: (n, 3) poses of the base by the log's odometry; None where it holds none.
    """

    scans: tuple[LaserScan, ...]
    truth: Trajectory
    exact: FloatArray
    objects: FloatArray
    residual: FloatArray
    odometry: FloatArray | None

    def simulate_log(
        self, noise: SensorNoise, seed: int, *, resampled: bool = False
    ) -> list[tuple[LaserScan, Pose2]]:
        """Return the scans and the odometry that simulated sensors record; odometry may be constant.

        The beams' noise is drawn beam by beam, or `resampled` from the log's residuals.
        """
        assert isinstance(noise.lidar, LidarNoise)
        drawn = noisy_ranges(self.exact, self.scans[0].range_max, noise.lidar, seed)
        if resampled:
            other = self.exact + self.residual[resample_blocks(self.truth, np.random.default_rng(seed))]
            drawn = np.where(np.isfinite(other), other, drawn)
        ranges = np.where(np.isnan(self.objects), drawn, self.objects).astype(np.float32)
        scans = [replace(scan, ranges=row) for scan, row in zip(self.scans, ranges, strict=True)]
        odometry = [Pose2()] * len(scans)
        if self.odometry is not None:
            odometry = simulate_odometry(self.truth, noise, seed)
        return list(zip(scans, odometry, strict=True))


def resample_blocks(truth: Trajectory, rng: np.random.Generator) -> IntArray:
    """Return (n,) for each scan one of a random block, block by block."""
    block = blocks_of(truth.planar_at(truth.stamps))
    members = [np.flatnonzero(block == b) for b in np.unique(block)]
    sources = rng.integers(len(members), size=len(members)).tolist()
    return np.concatenate(
        [np.resize(members[source], len(own)) for own, source in zip(members, sources, strict=True)]
    )


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
        residual = np.where(localized & np.isfinite(log.ranges), log.ranges - exact, np.nan)
        lacking = np.isfinite(log.ranges) & localized & ~(np.abs(residual) <= GATE)
    mounts = (scan.T_base_laser.to_pose2().inverse() for scan in scans)
    truth = [Pose2(*pose) @ mount for pose, mount in zip(poses.tolist(), mounts, strict=True)]
    stamps = [scan.stamp for scan in scans]
    rows = [pose.as_array() for pose in odometry if pose is not None]
    return TwinPath(
        tuple(scans),
        Trajectory.from_poses(stamps, truth),
        exact,
        np.where(lacking, log.ranges, np.nan),
        np.where(lacking, np.nan, residual),
        np.array(rows) if len(rows) == len(scans) else None,
    )


def simulate_odometry(truth: Trajectory, noise: SensorNoise, seed: int) -> list[Pose2]:
    """Return `T_odom_base` by noisy wheels and gyro; it rests where the path does."""
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
    truth: Truth,
    path: TwinPath,
    noises: Sequence[SensorNoise],
    names: Sequence[str],
    folder: Path,
    jobs: int,
    progress: Progress,
) -> Replay:
    """Map a log and its simulations by some mappers; return their errors.

    Each noise has a simulated log with a seed of its own, also of the mapper; every second one has residuals
    of the log, since neighboring beams and scans err alike to an unknown degree. The truth of the log is its
    relations or its reference; without both only the simulations are mapped. The folder receives the first
    simulated log, and the true path.
    """
    drive_files.write_tum(folder / "truth.tum", path.truth)
    logs = [path.simulate_log(noise, config.seed + k, resampled=k % 2 == 1) for k, noise in enumerate(noises)]
    written = [folder / f"simulated-{config.seed + k}.clf.gz" for k in range(len(logs))]
    for file, log in zip(written, logs, strict=True):
        drive_files.write_scans(file, log)
    on_path = None if truth[0] is None else _relations_on(path.truth, truth[0])
    rows = []
    with process_pool(jobs) as pool:
        for name in names:
            own = {key: getattr(config, key) for key in OWN} if name == config.mapper else OWN
            options = {"mapper": name, "second": "none"} | own
            draws = [
                MapConfig(log=str(file), seed=config.seed + k, **options) for k, file in enumerate(written)
            ]
            tasks = [partial(_map_once, draw, on_path, path.truth) for draw in draws]
            if truth != (None, None):
                real = replace(config, relations=None, reference=None, **options)
                tasks.append(partial(_map_once, real, *truth))
            rows.append(_replay_mapper(name, tasks, len(draws), pool, progress))
    for file in written[1:]:
        file.unlink()
    metric = "ATE" if truth[0] is None else "mean error of the relations"
    return Replay(metric, tuple(rows), _compare_odometry(path, logs))


def _map_once(
    config: MapConfig,
    relations: Sequence[RelativePoseConstraint] | None,
    reference: Trajectory | None,
    progress: Progress,
) -> tuple[float | None, str]:
    """Map a log; return its error, of relations where given, else the ATE, and status."""
    mapped = run_mapping(config)
    found = trajectory_accuracy(mapped.trajectory, mapped.log.track, relations, reference).metrics()
    kind, name = ("reference", "ate_rmse") if relations is None else ("relations", "translation_mean")
    return found[kind][name], mapped.record.status


def _replay_mapper(
    name: str,
    tasks: Sequence[Job[tuple[float | None, str]]],
    draws: int,
    pool: WorkerPool | None,
    progress: Progress,
) -> ReplayedMapper:
    """Map the simulated logs, and last the log if there is a task for it."""
    found = {}
    try:
        ended = enumerate(task(no_progress) for task in tasks) if pool is None else pool.run(tasks)
        for number, value in ended:
            if isinstance(value, Failure):
                raise SourceError(f"its process died: {value.reason}")
            found[number] = value
            progress(f"replay {name}", len(found) / len(tasks))
    except SourceError as error:
        return ReplayedMapper(name, reason=str(error))
    errors, status = zip(*(found[k] for k in range(len(tasks))), strict=True)
    real = errors[draws] if len(tasks) > draws else None
    return ReplayedMapper(name, real, errors[:draws], status)


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


def replay_figure(replay: Replay) -> Drawing:
    """Draw each mapper's errors on the simulated logs, their interval and the log's error."""
    figure = new_figure(6.5, 1.2 + 0.45 * len(replay.mappers))
    ax = figure.subplots()
    for row, m in enumerate(replay.mappers):
        drawn = [error for error in m.drawn if error is not None]
        ax.plot(drawn, [row] * len(drawn), "|", color=GRAY)
        if m.spread is not None:
            ax.plot((m.spread.low, m.spread.high), (row, row), color=BLUE, linewidth=2)
        if m.real is not None:
            ax.plot(m.real, row, "o", color=VERMILLION)
    ax.set_xscale("log")
    ax.set_yticks(range(len(replay.mappers)), [m.mapper for m in replay.mappers])
    ax.invert_yaxis()
    plain_axes(ax, f"{replay.metric}, m", "")
    title(ax, "Draws (gray), interval (blue), log (red, where known)")
    return figure


def replay_table(replay: Replay | None) -> ReportTable:
    """Return the interval of each mapper's errors, and its error on the log."""
    headings = ("mapper", "interval, m", "draws inside", "log, m", "log", "remark")
    if replay is None:
        return ReportTable("replay", "Mappers", "The replay was not requested.", headings, ())
    rows = []
    for m in replay.mappers:
        lost = sum(status != "ok" for status in m.status[: len(m.drawn)])
        remarks = [f"{status} on the log" for status in m.status[len(m.drawn) :] if status != "ok"]
        remarks += [f"not ok on {lost} of {len(m.drawn)} simulated logs"] if lost else []
        interval = (NOTHING, NOTHING)
        if m.spread is not None:
            interval = f"{m.spread.low:.3f} to {m.spread.high:.3f}", m.spread.count
        real = NOTHING if m.real is None else f"{m.real:.3f}"
        place = {None: NOTHING, True: "inside", False: "outside"}[m.inside]
        rows.append((m.mapper, *interval, real, place, m.reason or ", ".join(remarks)))
    caption = (
        f"{replay.metric} on simulated logs. They have the path of the log, noise drawn from the fit's "
        "intervals, and objects that the map lacks as the log saw them."
    )
    return ReportTable("replay", "Mappers", caption, headings, tuple(rows), remarks=True)
