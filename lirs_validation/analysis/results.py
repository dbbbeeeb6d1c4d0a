"""Finished results: folders of runs, and the config, poses and scans of one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_validation.analysis.compare import by_shared
from lirs_validation.collision.validation import CollisionVerdict
from lirs_validation.config import RunConfig
from lirs_validation.record.map_record import is_mapped_log
from lirs_validation.record.metric_catalog import Entry
from lirs_validation.record.run_record import (
    RECORD,
    RunGroup,
    distinguishing_fields,
    read_record,
    schema_error,
    source_files,
)
from lirs_validation.sweep.sweep import MANIFEST, read_status
from lirs_validation.sweep.tasks import STATUS, read_verdict
from lirs_wct import BuildOptions, ConfigError, Imu, OccupancyGrid, Pose2, Pose3, SourceError, Trajectory
from lirs_wct.errors import reason_of
from lirs_wct.formats import carmen_log, drive_files, laser_log
from lirs_wct.world import TEXTURE_OPTIONS
from slam_baselines.front_end import KnownPoseMapper

SHOWN_DIGITS = 12
"""Hex digits of a digest that a message shows."""
SAME_STAMP = 1e-4
"""Largest difference between stamps of the same scan in two files, seconds."""


@dataclass(frozen=True)
class RunFolder:
    """A run's folder and its record as nested dicts."""

    folder: Path
    entry: Entry


@dataclass(frozen=True)
class ResultFolder:
    """Contents of a folder of results.

    Attributes:
        root: Folder of the results.
        runs: Runs by name of their folders.
        collisions: Verdicts of collision validations.
        broken: Names of collision validations without a result, and why.
        skipped: Names of folders that cannot be read, and why.
        manifest: Content of `sweep.json`; None without one.
    """

    root: Path
    runs: tuple[RunFolder, ...]
    collisions: tuple[CollisionVerdict, ...] = ()
    broken: tuple[tuple[str, str], ...] = ()
    skipped: tuple[tuple[str, str], ...] = ()
    manifest: Entry | None = None


def read_run(folder: Path) -> RunFolder:
    """Read a run's folder."""
    entry = read_record(folder)
    problem = schema_error(entry)
    if problem is not None:
        raise SourceError(f"{folder / RECORD}: damaged: {problem}")
    return RunFolder(folder, entry)


def read_results(root: Path) -> ResultFolder:
    """Read a run's folder, or a folder of such folders; unreadable ones are listed.

    Raises:
        SourceError: there is no such folder, or no record in it can be read.
    """
    if not root.is_dir():
        raise SourceError(f"{root}: no such folder of results")
    if (root / RECORD).exists():
        return ResultFolder(root, (read_run(root),))
    runs: list[RunFolder] = []
    verdicts: list[CollisionVerdict] = []
    broken: list[tuple[str, str]] = []
    skipped: list[tuple[str, str]] = []
    for folder in sorted(p for p in root.iterdir() if p.is_dir() and not p.name.startswith(".")):
        try:
            if is_mapped_log(folder):
                continue  # a source of runs, and none itself
            if (folder / RECORD).exists():
                runs.append(read_run(folder))
            elif (folder / STATUS).exists():
                ending = read_status(folder / STATUS)
                if ending["status"] == "ok":
                    verdicts.append(read_verdict(folder))
                else:
                    broken.append((folder.name, ending["reason"] or ending["status"]))
        except SourceError as error:
            skipped.append((folder.name, str(error).removeprefix(f"{folder}/")))
    manifest = _manifest(root / MANIFEST, skipped)
    if not runs and not verdicts:
        named = "".join(f"; {name}: {reason}" for name, reason in skipped[:3])
        raise SourceError(f"{root}: holds no readable record of a run (folders with a record.json){named}")
    return ResultFolder(root, tuple(runs), tuple(verdicts), tuple(broken), tuple(skipped), manifest)


def read_baseline(folder: Path, cells: Sequence[Entry]) -> list[Entry]:
    """Return the stored runs that runs of a sweep repeat, by group and seed."""
    results = read_results(folder)
    for name, reason in results.skipped:
        raise SourceError(f"{folder / name}: {reason}")
    groups = by_shared([run.entry for run in results.runs], ())
    stored = {(group, seed): run for group, runs in groups.items() for seed, run in runs.items()}
    planned = [(RunGroup.of({"world": {"name": c["world"]}, "config": c}), c["seed"]) for c in cells]
    if found := [stored[run] for run in planned if run in stored]:
        return found
    fields = distinguishing_fields(group for group, _ in (*stored, *planned))
    required, *got = (f"{group.label(fields)}, seed {seed}" for group, seed in (planned[0], *stored))
    wanted = f"must hold one of the runs to drive, such as {required}"
    raise ConfigError(f"{folder}: {wanted}; got {got[0] if got else 'none'}")


def _manifest(path: Path, skipped: list[tuple[str, str]]) -> Entry | None:
    if not path.exists():
        return None
    try:
        entry: Entry = json.loads(path.read_text(encoding="utf-8"))
        if not all(isinstance(cell["name"], str) for cell in entry.get("cells", [])):
            raise ValueError("cells must be objects with a name")
        return entry
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        skipped.append((path.name, f"{path}: not readable, or damaged: {reason_of(error)}"))
        return None


def recorded_config(entry: Entry) -> RunConfig:
    """Return the config of a record."""
    run, build = dict(entry["config"]), dict(entry["config"]["build"])
    del run["build"]
    # Of version 1.0.0: options that never changed a run, and one that has another name.
    run.pop("threads", None)
    build.pop("log_mapper", None)
    if (pixel := build.pop("pixel_size", None)) is not None:
        build["resolution"] = pixel
    if build.get("origin", "") is None:
        del build["origin"]
    known = [{entry.name for entry in fields(options)} for options in (RunConfig, BuildOptions)]
    unknown = {*run} - known[0] | {*build} - known[1]
    if unknown:
        raise SourceError(f"{entry['name']}: options unknown to this version: {', '.join(sorted(unknown))}")
    defaults = BuildOptions()
    try:
        for name, value in build.items():
            if name == "start" and value is not None:
                build[name] = Pose2(**{key: float(number) for key, number in value.items()})
            elif name in TEXTURE_OPTIONS and value is not None:
                build[name] = Path(value)
            elif not _fits(value, getattr(defaults, name)):
                raise TypeError(f"{name} is {value!r}")
            elif isinstance(value, list):
                build[name] = tuple(value)
        return RunConfig(**run, build=BuildOptions(**build))
    except (ConfigError, TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
        reason = " ".join(str(error).split())
        raise SourceError(f"{entry['name']}: damaged: an option cannot be used: {reason}") from error


def _fits(value: object, default: object) -> bool:
    """Return whether an option's value has its default's type; without a default, any plain type."""
    if isinstance(value, list) and (default is None or isinstance(default, tuple)):
        return all(isinstance(part, int | float) for part in value)
    if default is None:
        return isinstance(value, int | float | str | None)
    return isinstance(value, str if isinstance(default, str) else int | float)


def recorded_world_config(entry: Entry) -> RunConfig:
    """Return the config of a record, with the recorded place of its unchanged source."""
    config, recorded = recorded_config(entry), entry["world"].get("files", ())
    if not recorded:  # a bundled world
        return config
    first = Path(recorded[0]["path"])
    in_folder = first.name == "world.json" and Path(config.source).name != first.name
    placed = replace(config, source=str(first.parent if in_folder else first))
    for file in source_files(placed):
        if file["sha256"] not in [known["sha256"] for known in recorded]:
            changed = f"sha256 {file['sha256'][:SHOWN_DIGITS]}..."
            raise SourceError(f"{file['path']}: is not what the run was made from: {changed}")
    return placed


def recorded_truth(folder: Path) -> Trajectory:
    """Return true base_link poses in the world frame; the first is the map frame."""
    path = folder / "truth.tum"
    truth = drive_files.read_tum(path)
    if len(truth) == 0:
        raise SourceError(f"{path}: holds no pose")
    return truth


def read_sensors(folder: Path, config: RunConfig) -> tuple[Trajectory, laser_log.LaserLog, tuple[Imu, ...]]:
    """Return true poses, scans and inertial readings of a run, one of each a scan.

    The log's messages hold only the planar part of the laser's mount; the robot gives all of it.
    """
    truth, log = recorded_truth(folder), carmen_log.read_carmen(folder / "scans.clf.gz")
    stamps, imu = log.stamps, drive_files.read_imu(folder / "imu.csv.gz")
    if not len(stamps) == len(truth) == len(imu) or np.abs(stamps - truth.stamps).max() > SAME_STAMP:
        raise SourceError(
            f"{folder}: not one drive: {len(stamps)} scans, {len(truth)} true poses, {len(imu)} IMU readings"
        )
    robot = make_robot(config.robot)
    mount, range_min = robot.T_base_laser, make_lidar_preset(config.lidar or robot.lidar).range_min
    scans = tuple(replace(scan, T_base_laser=mount, range_min=range_min) for scan in log.scans)
    return truth, replace(log, scans=scans), imu


def true_pose_map(folder: Path, config: RunConfig, resolution: float) -> OccupancyGrid:
    """Return the map of the recorded scans at the true poses, world frame."""
    truth, log, imu = read_sensors(folder, config)
    T_world_map, mapper = truth.pose2(0), KnownPoseMapper(resolution=resolution)
    for k, scan in enumerate(log.scans):
        pose = Pose3.from_arrays(truth.positions[k], truth.quaternions[k])
        mapper.update(scan, T_world_map.inverse() @ pose.to_pose2(), imu[k])
    return mapper.map().moved(T_world_map)
