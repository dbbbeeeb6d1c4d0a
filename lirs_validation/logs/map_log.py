"""A log becomes a map: log x mapper x seed -> map, trajectory, record.

A log that is a source of worlds is mapped once; later worlds are built from its map.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lirs_validation.config import MapConfig, sha256
from lirs_validation.experiment.mapper_under_test import (
    LocalMapper,
    LostRule,
    MapperProcess,
    MapperUnderTest,
    SensorReadings,
    mapper_named,
    needs_process,
)
from lirs_validation.logs.preflight import Preflight, check_log_data
from lirs_validation.logs.read_log import (
    check_log,
    inertial_readings,
    read_log,
    read_truth,
    truth_in_time,
    with_recorded_mount,
)
from lirs_validation.metrics.mapped_log import (
    Accuracy,
    odometry_scale,
    reference_errors,
    scan_consistency,
    trajectory_accuracy,
)
from lirs_validation.metrics.trajectory import associated, rms, scan_coverage
from lirs_validation.processes import CostMeter, compile_timer
from lirs_validation.record.map_record import MapRecord, describe_log, describe_map
from lirs_validation.record.run_record import RECORD, same_code
from lirs_validation.record.verdict import disagreement, incompleteness
from lirs_wct import (
    BuildOptions,
    ConfigError,
    Imu,
    LaserScan,
    OccupancyGrid,
    PointCloud,
    Pose3,
    Progress,
    SourceError,
    Trajectory,
    no_progress,
    unknown_name,
)
from lirs_wct.files import atomic_folder, atomic_write, check_writable
from lirs_wct.formats import METADATA, drive_files, map_server
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.formats.rosbag.topics import ANY
from lirs_wct.option import check_names, command_line
from lirs_wct.sources.bundled import RECIPES
from lirs_wct.sources.source import SourceKind, find_source, is_bag
from slam_baselines.front_end import KnownPoseMapper
from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS, file_name, make_mapper, read_parameters, warm_up
from slam_baselines.watch import MAX_STEP, Watch

if TYPE_CHECKING:
    from lirs_wct.drawing.canvas import Drawing

WARM_UP_CONFIG = {"gmapping": {"particles": 4}}
"""Kernels need no more particles than these to be compiled."""
HORIZONTAL = np.tan(np.radians(1.5))
"""Slope of the beams that count as horizontal, up and down: rings of lidars are mostly 2 deg apart."""
BEAMS = 720
RANGE_MAX = 100.0
RESOLUTION = 0.05
"""Edge of the map's cell, meters."""
SECOND = "hector"
"""Mapper that others are compared with: it takes a fraction of their time."""


@dataclass(frozen=True)
class MappedLog:
    """Result of mapping a log.

    Attributes:
        record: Config and metrics.
        log: Log as read.
        grid: Map; its frame is the first base pose.
        trajectory: Pose of every scan in the map, by the log's stamps.
        reference: Reference trajectory in its own frame; None without one.
        accuracy: Errors pose by pose.
        folder: Folder of the results; None = not written.
    """

    record: MapRecord
    log: LaserLog
    grid: OccupancyGrid
    trajectory: Trajectory
    reference: Trajectory | None
    accuracy: Accuracy
    folder: Path | None = None

    def overview(self) -> Drawing:
        """Draw the mapped log on one page."""
        # Loaded here: the first scan of a log does not wait for matplotlib.
        from lirs_validation.drawing import map_overview

        return map_overview(self.record, self.grid, self.trajectory, self.reference, self.accuracy)

    def __repr__(self) -> str:
        return f"MappedLog({self.record.config.log!r}, {self.trajectory!r}, folder={self.folder})"

    def _repr_png_(self) -> bytes:
        return self.overview()._repr_png_()


def map_log(
    log: str | Path, *, out: str | Path | None = None, progress: Progress = no_progress, **map_options: Any
) -> MappedLog:
    """Map a CARMEN log or a ROS bag.

    >>> map_log("intel.clf.gz", mapper="hector", relations="intel.relations.gz")  # doctest: +SKIP

    Args:
        log: Path of a .clf or .log file, gzipped or not, or of a bag.
        out: Folder that receives the map's folder; None = nothing is written.
        progress: Progress of the mapping.
        **map_options: Fields of `MapConfig`: mapper, seed, parameters, resolution, fov, range_max, relations,
            reference, imu, attitude, scan_topic, odom_topic, imu_topic, second.

    Raises:
        WctError: a file, a name or an option cannot be used, or results cannot be written.
    """
    check_names(MapConfig, map_options)
    texts = {name: str(value) for name, value in map_options.items() if isinstance(value, Path)}
    config = MapConfig(log=str(log), **map_options | texts)
    return run_mapping(config, out=None if out is None else Path(out), progress=progress)


def run_mapping(config: MapConfig, *, out: Path | None = None, progress: Progress = no_progress) -> MappedLog:
    """Map a log by its config (see `map_log`)."""
    if config.log in RECIPES and not Path(config.log).exists():
        raise SourceError(
            f"{config.log}: is a bundled world, map takes a CARMEN log or a ROS bag; to drive through it: "
            f"lirs-wct validate {config.log}"
        )
    if config.second is not None and config.second not in ("none", *MAPPERS):
        raise unknown_name("--second", config.second, ["none", *MAPPERS])
    check_writable(out)
    with log_mapper(config) as mapper:
        mapped = _mapped_log(config, mapper, progress)
    if out is None:
        return mapped
    progress("draw", 1.0)
    folder = out / mapped.record.name
    with atomic_folder(folder) as temporary:
        mapped.record.save(temporary)
        map_server.write_map(temporary / "map", mapped.grid)
        drive_files.write_tum(temporary / "estimate.tum", mapped.trajectory)
        mapped.overview().savefig(temporary / "overview.png")
    return replace(mapped, folder=folder)


@contextmanager
def log_mapper(config: MapConfig) -> Iterator[MapperUnderTest]:
    """Give the mapper of a log; foreign code works in its own process."""
    name, resolution = config.mapper, config.resolution
    mapper: MapperUnderTest
    if needs_process(name):
        if resolution is not None and name not in ALL_CLOUD_MAPPERS:
            raise ConfigError(f"resolution can be given for {', '.join(MAPPERS)} only")
        mapper = MapperProcess(config)
    elif resolution is None or name not in MAPPERS:
        mapper = LocalMapper(mapper_named(name, config.seed, config.parameters), name, config.attitude)
    else:
        parameters = {"resolution": resolution} | read_parameters(config.parameters)
        mapper = LocalMapper(make_mapper(name, seed=config.seed, **parameters), name, config.attitude)
    with closing(mapper):
        if mapper.reads_clouds and not is_bag(Path(config.log)):
            raise ConfigError(
                f"{config.log}: mapper {name} reads point clouds, a CARMEN log holds planar scans; "
                f"legal: {', '.join(MAPPERS)}"
            )
        yield mapper


def warm_up_log_mapper(config: MapConfig) -> None:
    """Compile a mapper's kernels; one of your own is not warmed up."""
    if config.mapper in MAPPERS:
        warm_up(config.mapper, **WARM_UP_CONFIG.get(config.mapper, {}))


def _mapped_log(config: MapConfig, mapper: MapperUnderTest, progress: Progress) -> MappedLog:
    """Read, map and evaluate a log."""
    meter, seconds = CostMeter(), dict[str, float]()
    truth = read_truth(config)
    progress("read", 0.0)
    with _measure_time(seconds, "read_seconds"):
        name, log = folder_name(config), read_log(config, clouds=mapper.reads_clouds)
        check_log(config, mapper, log)
        readings = inertial_readings(config, log)
        preflight = _preflight(config, log)
        log = log if config.imu is None or is_bag(Path(config.log)) else with_recorded_mount(config, log)
    progress("compile", 0.0)
    with compile_timer() as compile_seconds:
        warm_up_log_mapper(config)
    seconds["compile_seconds"] = compile_seconds()
    with _measure_time(seconds, "map_seconds"):
        tracking, alarms, level = replay(config, mapper, log, readings, progress)
        trajectory = mapper.trajectory()
        grid = horizontal_map(level, trajectory, config.resolution) if mapper.reads_clouds else mapper.map()
    cost = {**seconds, **asdict(meter.cost())}
    relations, reference = truth = truth_in_time(truth, log.lines)
    accuracy = trajectory_accuracy(trajectory, log.track, relations, reference)
    alone = trajectory_accuracy(log.track, log.track, *truth).metrics() if len(log.track) else {}
    path = _describe_path(log, trajectory)
    quality = asdict(found) if (found := scan_consistency(log.scans, readings, trajectory)) else {}
    if quality and alone and config.mapper in MAPPERS:
        alone["scale"] = odometry_scale(log.track, trajectory)
    judged = relations is not None or reference is not None or mapper.reads_clouds
    second = None if judged else _compare(config, log, readings, trajectory, progress)
    lost = tracking.reason() or disagreement(quality.get("revisit_residual"))
    lacking = incompleteness(path["scan_coverage"])
    record = MapRecord(
        name=name,
        config=config,
        status="lost" if lost else "incomplete" if lacking else "ok",
        reason=lost or lacking or "",
        log=describe_log(log)
        | {"inertial_readings": sum(reading is not None for reading in readings)}
        | {"unfit": preflight.unfit, "findings": [str(finding) for finding in preflight.findings]},
        map=describe_map(grid),
        trajectory=path | {"alarms": alarms},
        mapper=asdict(mapper.stats),
        accuracy=accuracy.metrics(),
        quality=quality | {"second": second},
        odometry=alone,
        cost=cost,
    )
    return MappedLog(record, log, grid, trajectory, reference, accuracy)


def _describe_path(log: LaserLog, trajectory: Trajectory) -> dict[str, Any]:
    """Return a record's description of a trajectory; left-out scans lack a pose."""
    used = len(log.stamps) / (len(log.stamps) + log.left_out)
    return {
        "poses": len(trajectory),
        "length": trajectory.length,
        "scan_coverage": used * scan_coverage(log.stamps, trajectory.stamps),
    }


def _preflight(config: MapConfig, log: LaserLog) -> Preflight:
    """Check a log's data; warn of one that is not fit."""
    preflight = check_log_data(log)
    if any(finding.hopeless for finding in preflight.findings):
        raise SourceError(f"{config.log}: {preflight.sentence}")
    if preflight.unfit:
        warnings.warn(f"{config.log}: {preflight.sentence}", stacklevel=2)
    return preflight


def _compare(
    config: MapConfig, log: LaserLog, readings: Sequence[Imu | None], path: Trajectory, progress: Progress
) -> dict[str, Any] | None:
    """Compare the path with a second mapper's; None if not requested or possible."""
    name = config.second or ("cartographer" if config.mapper == SECOND else SECOND)
    if name == "none":
        return None
    other = replace(config, mapper=name, resolution=None, parameters="", second=None)
    with log_mapper(other) as mapper:
        if mapper.requires_odometry and log.odometry[0] is None:
            return None
        warm_up_log_mapper(other)
        replay(other, mapper, log, readings, lambda _, share: progress("compare", share))
        second = mapper.trajectory()
    distances = reference_errors(path, second).position
    own = scan_consistency(log.scans, readings, second)
    return {
        "mapper": name,
        "difference": rms(distances) if len(distances) else None,
        "revisit_residual": own and own.revisit_residual,
        "command": command_line("map", config.log, other, mapper=name),
    }


def replay(
    config: MapConfig,
    mapper: MapperUnderTest,
    log: LaserLog,
    readings: Sequence[Imu | None],
    progress: Progress,
) -> tuple[LostRule, list[float] | None, list[LaserScan]]:
    """Replay a log; return losses, alarms (None where scans are too rare) and horizontal beams."""
    tracking, watch, level, points, before = LostRule(), Watch(), list[LaserScan](), 0, -np.inf
    scans: Iterable[LaserScan | PointCloud] = log.scans if log.clouds is None else log.clouds
    for k, (scan, odometry, imu) in enumerate(zip(scans, log.odometry, readings, strict=True)):
        if isinstance(scan, LaserScan):
            observation = SensorReadings(scan, odometry, imu)
        else:
            inertial = None if log.inertial is None else log.inertial.between(before, scan.stamp)
            observation = SensorReadings(None, odometry, imu, scan, inertial)
            level.append(horizontal_scan(scan))
            points += len(scan)
            before = scan.stamp
        try:
            estimate = mapper.observe(observation)
        except ConfigError as error:
            raise SourceError(f"{config.log}: {error}") from error
        tracking.observe(scan.stamp, estimate.lost)
        pose = estimate.pose
        watch.update(pose.to_pose2() if isinstance(pose, Pose3) else pose, scan.stamp, odometry)
        progress("map", (k + 1) / len(readings))
    if level and not points:
        raise SourceError(f"{config.log}: none of its {len(level)} point clouds holds a valid point")
    rare = log.stamps[-1] - log.stamps[0] > MAX_STEP * len(log.stamps)
    return tracking, None if rare else [stamp - log.stamps[0] for stamp in watch.alarms], level


def horizontal_scan(cloud: PointCloud) -> LaserScan:
    """Return the nearest horizontal point per half degree; NaN where there is none."""
    p = cloud.T_base_laser
    turn = Pose3(0.0, 0.0, 0.0, p.qw, p.qx, p.qy, p.qz)
    x, y, z = turn.apply(cloud.xyz.astype(np.float64)).T
    distance = np.hypot(x, y)
    level = np.abs(z) <= HORIZONTAL * distance
    beam = np.rint((np.arctan2(y, x)[level] + np.pi) * BEAMS / (2 * np.pi)).astype(np.int64) % BEAMS
    ranges = np.full(BEAMS, np.inf)
    np.minimum.at(ranges, beam, distance[level])
    ranges[np.isinf(ranges)] = np.nan
    mount = Pose3(p.x, p.y, p.z)
    step = 2 * np.pi / BEAMS
    return LaserScan(ranges.astype(np.float32), -np.pi, step, 0.0, RANGE_MAX, cloud.stamp, mount)


def horizontal_map(
    scans: Sequence[LaserScan], trajectory: Trajectory, resolution: float | None
) -> OccupancyGrid:
    """Return the occupancy map of horizontal beams at a mapper's final poses."""
    builder = KnownPoseMapper(resolution=resolution or RESOLUTION)
    stamps = np.array([scan.stamp for scan in scans])
    for k, pose in zip(*associated(stamps, trajectory.stamps), strict=True):
        builder.update(scans[k], trajectory.pose2(int(pose)), None)
    return builder.map()


def check_log_file(log: str | Path, **log_options: Any) -> Preflight:
    """Measure a log's data and look for faults; options are those of `LogOptions`."""
    inertial = {"imu_topic": ANY} if is_bag(Path(log)) else {}
    return check_log_data(read_log(MapConfig(log=str(log), **inertial | log_options)))


def folder_name(config: MapConfig) -> str:
    """Return the folder name: log, mapper, seed and a digest of other options."""
    path = Path(config.log)
    try:
        readings = None if config.imu is None else Path(config.imu).read_bytes()
        content: bytes | Path = path
        if path.is_dir():  # a bag: its own files alone, whatever else lies in the folder
            files = filter(Path.is_file, path.iterdir())
            parts = sorted(part for part in files if part.name == METADATA or is_bag(part))
            content = b"".join(bytes.fromhex(sha256(part)) for part in parts)
        digest = config.digest(content, readings)
    except OSError as error:
        raise SourceError(f"{error.filename}: cannot be read: {error.strerror or error}") from error
    stem = find_source(path, BuildOptions()).name
    return f"{stem}-{file_name(config.mapper)}-s{config.seed}-{digest}"


@contextmanager
def _measure_time(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Note under a name how many wall seconds a block takes."""
    begun = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - begun


def resolve_source(
    source: str | Path,
    options: BuildOptions,
    out: str | Path,
    progress: Progress = no_progress,
    **map_options: Any,
) -> str | Path:
    """Return the source, or for a log the YAML file of its map.

    The map is made into `out` as `lirs-wct map` makes it. One that lies there already is used again, if
    this very log and this very code made it. Other options are those of `MapConfig`.

    Raises:
        WctError: there is no such source, the log cannot be mapped, or the map cannot be written.
    """
    log = find_source(source, BuildOptions())
    if log.kind is not SourceKind.LOG:
        return source
    config = MapConfig(log=str(source), resolution=options.resolution, second="none", **map_options)
    folder = Path(out) / folder_name(config)
    ending = _read_ending(folder)
    if ending is None:
        record = run_mapping(config, out=Path(out), progress=progress).record
        ending = record.status, record.reason
    status, reason = ending
    if status != "ok":
        what = "left out scans of" if status == "incomplete" else "lost its place in"
        raise SourceError(
            f"{source}: {config.mapper} {what} this log ({reason}), its map is no world (see {folder}); "
            f"lirs-wct map {source} --mapper NAME maps it with another method"
        )
    named = folder / f"{log.name}.yaml"
    with atomic_write(named) as path:
        path.write_bytes((folder / "map.yaml").read_bytes())
    return named


def _read_ending(folder: Path) -> tuple[str, str] | None:
    """Return status and reason of a finished mapping; None without a current result."""
    path = folder / RECORD
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        ended, written_by = (str(record["status"]), str(record["reason"])), record["versions"]
        map_server.read_map(folder / "map.yaml")
    except (OSError, ValueError, KeyError, TypeError, RecursionError, SourceError):
        return None
    # The folder's name holds the digest of the log: another content is another folder.
    return ended if same_code(written_by) else None
