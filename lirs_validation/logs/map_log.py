"""A log becomes a map: log x mapper x seed -> map, trajectory, record.

A log that is a source of worlds is mapped once; later worlds are built from its map.
"""

from __future__ import annotations

import codecs
import hashlib
import json
import math
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lirs_validation.experiment.cost import CostMeter, compile_timer
from lirs_validation.experiment.mapper_under_test import MapperUnderTest
from lirs_validation.logs.log_replay import (
    check_log,
    horizontal_map,
    inertial_readings,
    log_mapper,
    replay,
    replay_clouds,
    warm_up_log_mapper,
    with_recorded_mount,
)
from lirs_validation.logs.preflight import Preflight, check_log_data
from lirs_validation.map_config import MapConfig
from lirs_validation.metrics.alignment import rms, scan_coverage
from lirs_validation.metrics.consistency import contradicted_share, scan_consistency
from lirs_validation.metrics.trajectory import (
    Accuracy,
    RelativePoseConstraint,
    read_constraints,
    reference_errors,
    trajectory_accuracy,
)
from lirs_validation.record.map_record import MapRecord, describe_log, describe_map
from lirs_validation.record.provenance import is_stale
from lirs_validation.record.verdict import LostRule, incompleteness, inconsistency
from lirs_wct import BuildOptions, ConfigError, Imu, OccupancyGrid, SourceError, Trajectory, unknown_name
from lirs_wct.arrays import FloatArray
from lirs_wct.files import atomic_folder, atomic_write, check_writable, readable_lines
from lirs_wct.formats import carmen_log, drive_files, map_server, suffixes
from lirs_wct.formats.laser_log import LaserLog, LineStamps
from lirs_wct.formats.rosbag.topics import ANY, Topics
from lirs_wct.option import check_names
from lirs_wct.progress import Progress, no_progress
from lirs_wct.sources.bundled import RECIPES
from lirs_wct.sources.source import SourceKind, find_source, is_bag
from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS, file_name

if TYPE_CHECKING:
    from lirs_wct.drawing.canvas import Drawing

SECOND = "hector"
"""Mapper that others are compared with: it takes a fraction of their time."""


@dataclass(frozen=True)
class MappedLog:
    """Result of mapping a log.

    Attributes:
        record: config and metrics.
        log: as read.
        grid: the map; its frame is the first base pose.
        trajectory: pose of every scan in the map, by the log's stamps.
        reference: in its own frame; None where none was given.
        accuracy: errors pose by pose.
        folder: where it was written; None = nowhere.
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
        log: path of a .clf or .log file, gzipped or not, or of a bag.
        out: folder that receives the map's folder; None = nothing is written.
        progress: of the mapping.
        **map_options: fields of `MapConfig`: mapper, seed, parameters, resolution, fov, range_max, relations,
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


def _mapped_log(config: MapConfig, mapper: MapperUnderTest, progress: Progress) -> MappedLog:
    """Read, map and evaluate a log."""
    meter, seconds = CostMeter(), dict[str, float]()
    truth = read_truth(config)
    progress("read", 0.0)
    with _measure_time(seconds, "read_seconds"):
        name, log = folder_name(config), read_log(config, clouds=mapper.reads_clouds)
        check_log(config, mapper, log)
        readings = inertial_readings(config, log)
        found = _preflight(config, log)
        log = log if config.imu is None or is_bag(Path(config.log)) else with_recorded_mount(config, log)
    progress("compile", 0.0)
    with compile_timer() as compile_seconds:
        warm_up_log_mapper(config)
    seconds["compile_seconds"] = compile_seconds()
    with _measure_time(seconds, "map_seconds"):
        tracking, grid, trajectory = _map(config, mapper, log, readings, progress)
    relations, reference = truth_in_time(truth, log.lines)
    accuracy = trajectory_accuracy(trajectory, log.track, relations, reference)
    cost = {**seconds, **asdict(meter.cost())}
    used = len(log.stamps) / (len(log.stamps) + log.left_out)
    coverage = used * scan_coverage(log.stamps, trajectory.stamps)
    contradicted = contradicted_share(log.scans, readings, trajectory)
    quality = scan_consistency(log.scans, readings, trajectory)
    judged = relations is not None or reference is not None
    second = None if judged or mapper.reads_clouds else _compare(config, log, readings, trajectory, progress)
    lost, lacking = tracking.reason() or inconsistency(contradicted), incompleteness(coverage)
    record = MapRecord(
        name=name,
        config=config,
        status="lost" if lost else "incomplete" if lacking else "ok",
        reason=lost or lacking or "",
        log=describe_log(log)
        | {"inertial_readings": sum(reading is not None for reading in readings)}
        | {"unfit": found.unfit, "findings": [str(finding) for finding in found.findings]},
        map=describe_map(grid),
        trajectory={
            "poses": len(trajectory),
            "length": trajectory.length,
            "scan_coverage": coverage,
            "contradicted": contradicted,
        },
        mapper=asdict(mapper.stats),
        accuracy=accuracy.metrics(),
        quality=(asdict(quality) if quality else {}) | {"second": second},
        odometry=odometry_accuracy(log.track, relations, reference),
        cost=cost,
    )
    return MappedLog(record, log, grid, trajectory, reference, accuracy)


def _preflight(config: MapConfig, log: LaserLog) -> Preflight:
    """Check a log's data; warn of one that is not fit.

    Raises:
        SourceError: a map would not fit into memory.
    """
    found = check_log_data(log)
    if any(finding.hopeless for finding in found.findings):
        raise SourceError(f"{config.log}: {found.sentence}")
    if found.unfit:
        warnings.warn(f"{config.log}: {found.sentence}", stacklevel=2)
    return found


def _map(
    config: MapConfig,
    mapper: MapperUnderTest,
    log: LaserLog,
    readings: Sequence[Imu | None],
    progress: Progress,
) -> tuple[LostRule, OccupancyGrid, Trajectory]:
    """Return tracking, map and trajectory of a log."""
    if not mapper.reads_clouds:
        tracking = replay(config, mapper, log, readings, progress)
        return tracking, mapper.map(), mapper.trajectory()
    tracking, level = replay_clouds(config.log, mapper, log, readings, progress)
    trajectory = mapper.trajectory()
    return tracking, horizontal_map(level, trajectory, config.resolution), trajectory


def _compare(
    config: MapConfig, log: LaserLog, readings: Sequence[Imu | None], path: Trajectory, progress: Progress
) -> dict[str, Any] | None:
    """Compare the path with a second mapper's.

    Returns:
        Its name, its revisit residual and the difference of the paths, meters; None if not requested, or if
        the log lacks data that the second mapper needs.
    """
    name = config.second or ("cartographer" if config.mapper == SECOND else SECOND)
    if name == "none":
        return None
    other = replace(config, mapper=name, resolution=None, parameters="")
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
    }


def read_log(config: MapConfig, *, clouds: bool = False) -> LaserLog:
    """Read the log with the config's laser options; of a bag, clouds if requested."""
    path = Path(config.log)
    topics = (config.scan_topic, config.odom_topic, config.imu_topic)
    if is_bag(path):
        if config.fov is not None:
            raise ConfigError(f"{path}: the messages of a bag say their field of view themselves")
        from lirs_wct.formats.rosbag.reader import read_bag

        others = ", ".join(MAPPERS if clouds else ALL_CLOUD_MAPPERS)
        names = Topics(*topics, clouds, others)
        return read_bag(path, names, range_max=config.range_max, time=config.time)
    if any(topics) or config.time != "header":
        raise ConfigError(f"{path}: topics and --time can be given for a ROS bag only, this is none")
    fov = None if config.fov is None else math.radians(config.fov)
    return carmen_log.read_carmen(path, fov=fov, range_max=config.range_max)


def check_log_file(log: str | Path, **log_options: Any) -> Preflight:
    """Measure a log's data and look for faults, without mapping it.

    Args:
        log: Path of a CARMEN log or a ROS bag.
        **log_options: Fields of `LogOptions`: fov, range_max, scan_topic, odom_topic, imu_topic, time.

    Raises:
        WctError: the log or an option cannot be used.
    """
    inertial = {"imu_topic": ANY} if is_bag(Path(log)) else {}
    return check_log_data(read_log(MapConfig(log=str(log), **inertial | log_options)))


def folder_name(config: MapConfig) -> str:
    """Return the folder name: log, mapper, seed and a digest of other options.

    Raises:
        SourceError: the log cannot be read.
    """
    path = Path(config.log)
    try:
        readings = None if config.imu is None else Path(config.imu).read_bytes()
        digest = config.digest(_digests(path) if path.is_dir() else path, readings)
    except OSError as error:
        raise SourceError(f"{error.filename}: cannot be read: {error.strerror or error}") from error
    stem = find_source(path, BuildOptions()).name
    return f"{stem}-{file_name(config.mapper)}-s{config.seed}-{digest}"


def _digests(folder: Path) -> bytes:
    """Return digests of a bag's files, ordered by name, without other files of the folder."""
    digests = []
    for path in sorted(p for p in folder.iterdir() if p.name == suffixes.METADATA or suffixes.is_bag_file(p)):
        with path.open("rb") as file:
            digests.append(hashlib.file_digest(file, "sha256").digest())
    return b"".join(digests)


@contextmanager
def _measure_time(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Note under a name how many wall seconds a block takes."""
    begun = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - begun


def read_trajectory(path: Path, scans: FloatArray | None = None) -> Trajectory:
    """Read a trajectory from a TUM, EuRoC or KITTI file, or a bag.

    A bag holds transforms from map to base_link, or a topic of poses; BAG:/TOPIC names it.

    Args:
        path: File or bag.
        scans: (n,) Stamps of the scans, seconds, which a KITTI file lacks.

    Raises:
        SourceError: it is neither, or has no such topic, or holds no poses.
        ConfigError: a topic is given, and it is no bag.
    """
    path, topic = _split_topic(path)
    if is_bag(path):
        from lirs_wct.formats.rosbag.frames import read_poses

        return read_poses(path, topic)
    if topic is not None:
        raise ConfigError(f"{path}: a topic can be given for a ROS bag only, this is none")
    return drive_files.read_tum(path, scans)


def _split_topic(path: Path) -> tuple[Path, str | None]:
    """Return bag and topic of a text such as `run.mcap:/pose`."""
    bag, colon, topic = str(path).partition(":/")
    return (path, None) if not colon or path.exists() else (Path(bag), f"/{topic}")


def read_reference(path: Path) -> Trajectory:
    """Read a reference trajectory.

    The file is a TUM or EuRoC file, a bag or BAG:/TOPIC, or a CARMEN log with corrected poses (as of a pose
    graph's nodes).

    Raises:
        SourceError: it is none of these, or holds no poses.
        ConfigError: a topic is given, and it is no bag.
    """
    bag, topic = _split_topic(path)
    if is_bag(bag) or topic is not None:
        return read_trajectory(path)
    if _begins_with_a_number(path):
        return drive_files.read_tum(path)
    track = carmen_log.read_carmen(path).track
    if len(track) == 0:
        raise SourceError(f"{path}: holds no poses that change, a reference trajectory does")
    return track


def _begins_with_a_number(path: Path) -> bool:
    """Return whether a file begins with a number, after comments."""
    for line in readable_lines(path):
        tokens = line.removeprefix(codecs.BOM_UTF8).replace(b",", b" ").split(None, 1)
        if tokens and not tokens[0].startswith(b"#"):
            try:
                float(tokens[0])
            except ValueError:
                return False
            return True
    return False


Relations = tuple[RelativePoseConstraint, ...]
Truth = tuple[Relations | None, Trajectory | None]
"""True relations and reference trajectory of a log; None where they are not given."""


def read_truth(config: MapConfig) -> Truth:
    """Read the relations and the reference trajectory, where they are given."""
    c = config
    return (
        None if c.relations is None else read_constraints(Path(c.relations)),
        None if c.reference is None else read_reference(Path(c.reference)),
    )


def odometry_accuracy(
    odometry: Trajectory, relations: Sequence[RelativePoseConstraint] | None, reference: Trajectory | None
) -> dict[str, Any]:
    """Return the accuracy of a log's raw odometry; empty without odometry."""
    if len(odometry) == 0:
        return {}
    return trajectory_accuracy(odometry, odometry, relations, reference).metrics()


def truth_in_time(truth: Truth, lines: LineStamps) -> Truth:
    """Return relations and reference with repaired stamps instead of logged ones.

    Of reference poses with the same stamp, the first stays.
    """
    relations, reference = truth
    if lines.moved and relations:
        logged = np.array([(r.stamp_a, r.stamp_b) for r in relations])
        pairs = zip(relations, lines.repaired_at(logged).tolist(), strict=True)
        relations = tuple(replace(relation, stamp_a=a, stamp_b=b) for relation, (a, b) in pairs)
    if lines.moved and reference is not None:
        stamps, first = np.unique(lines.repaired_at(reference.stamps), return_index=True)
        reference = Trajectory(stamps, reference.positions[first], reference.quaternions[first])
    return relations, reference


def resolve_source(
    source: str | Path, options: BuildOptions, out: str | Path, progress: Progress = no_progress
) -> str | Path:
    """Return the source, or for a log the YAML file of its map.

    The map is made into `out` as `lirs-wct map` makes it. One that lies there already is used again, if
    this very log and this very code made it.

    Raises:
        WctError: there is no such source, the log cannot be mapped, or the map cannot be written.
    """
    found = find_source(source, BuildOptions())
    if found.kind is not SourceKind.LOG:
        return source
    config = MapConfig(log=str(source), resolution=options.resolution, second="none")
    out = Path(out)
    folder = out / folder_name(config)
    found_before = _read_ending(folder)
    if found_before is None:
        record = run_mapping(config, out=out, progress=progress).record
        found_before = record.status, record.reason
    status, reason = found_before
    if status != "ok":
        what = "left out scans of" if status == "incomplete" else "lost its place in"
        raise SourceError(
            f"{source}: {config.mapper} {what} this log ({reason}), its map is no world (see {folder}); "
            f"lirs-wct map {source} --mapper NAME maps it with another method"
        )
    named = folder / f"{found.name}.yaml"
    with atomic_write(named) as path:
        path.write_bytes((folder / "map.yaml").read_bytes())
    return named


def _read_ending(folder: Path) -> tuple[str, str] | None:
    """Return status and reason of a finished mapping; None without a current result."""
    path = folder / "record.json"
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        ended, written_by = (str(record["status"]), str(record["reason"])), record["versions"]
        map_server.read_map(folder / "map.yaml")
    except (OSError, ValueError, KeyError, TypeError, RecursionError, SourceError):
        return None
    # The folder's name holds the digest of the log: another content is another folder.
    return None if is_stale(path, written_by, inputs=()) else ended
