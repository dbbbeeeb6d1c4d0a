"""What a run recorded, read back: its config, its world's place, its scans with the true poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.catalog import make_robot
from lirs_validation.config import RunConfig, SourceOptions
from lirs_validation.record.source_files import with_recorded_source
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.imu_csv import read_imu
from lirs_wct.formats.tum import read_tum
from lirs_wct.formats.world_json import TEXTURE_OPTIONS
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.mapping.known_pose import KnownPoseMapper

SAME_STAMP = 1e-4
"""Stamps of the same scan in two files differ by no more, seconds."""


def recorded_config(entry: Mapping[str, Any]) -> RunConfig:
    """Return the config of a record.

    Raises:
        SourceError: it has options that this version does not know.
    """
    held = dict(entry["config"])
    given: dict[str, Any] = {
        key: tuple(v) if isinstance(v, list) else v for key, v in dict(held.pop("build")).items()
    }
    unknown = (set(held) - {f.name for f in fields(RunConfig)}) | (
        set(given) - {f.name for f in fields(SourceOptions)}
    )
    if unknown:
        raise SourceError(f"{entry['name']}: options unknown to this version: {', '.join(sorted(unknown))}")
    try:
        if given.get("origin") is not None:
            given["origin"] = Pose2(**{key: float(value) for key, value in given["origin"].items()})
        for key, value in given.items():
            if not _fits(value, getattr(SourceOptions(), key)):
                raise TypeError(f"{key} is {value!r}")
        for role in TEXTURE_OPTIONS:
            if given.get(role) is not None:
                given[role] = Path(given[role])
        return RunConfig(**held, build=SourceOptions(**given))
    except (ConfigError, TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
        reason = " ".join(str(error).split())
        raise SourceError(f"{entry['name']}: damaged: an option cannot be used: {reason}") from error


def _fits(value: object, default: object) -> bool:
    """Whether an option's value is of its default's kind; of an option without one, any plain value."""
    if isinstance(value, tuple) and (default is None or isinstance(default, tuple)):
        return all(isinstance(part, (int, float)) for part in value)
    if default is None:
        return value is None or isinstance(value, (int, float, str, Pose2))
    return isinstance(value, str if isinstance(default, str) else (int, float))


def recorded_world_config(entry: Mapping[str, Any]) -> RunConfig:
    """Return the config of a record with the very source that the run was made from, wherever one stands.

    Raises:
        SourceError: it has options that this version does not know, or its source is no longer what it was.
    """
    return with_recorded_source(recorded_config(entry), entry["world"].get("files", ()))


def recorded_truth(folder: Path) -> Trajectory:
    """Return the true poses of base_link in the world frame; the first is where the map frame lies.

    Raises:
        SourceError: missing, damaged or empty.
    """
    path = folder / "truth.tum"
    truth = read_tum(path)
    if len(truth) == 0:
        raise SourceError(f"{path}: holds no pose")
    return truth


def true_pose_map(folder: Path, config: RunConfig, resolution: float) -> OccupancyGrid:
    """Return the map, in the world frame, that the recorded scans give at the true poses.

    The log's messages have the laser's mount in the plane only: all of it comes from the robot.

    Raises:
        SourceError: scans, poses or inertial readings are missing, damaged, or not of one drive.
    """
    truth, log = recorded_truth(folder), read_carmen(folder / "scans.clf.gz")
    stamps, imu = log.stamps, read_imu(folder / "imu.csv.gz")
    if not len(stamps) == len(truth) == len(imu) or np.abs(stamps - truth.stamps).max() > SAME_STAMP:
        raise SourceError(
            f"{folder}: not one drive: {len(stamps)} scans, {len(truth)} true poses, {len(imu)} IMU readings"
        )
    T_world_map, T_base_laser = truth.pose2(0), make_robot(config.robot).T_base_laser
    range_min = make_lidar_preset(config.lidar or make_robot(config.robot).lidar).range_min
    mapper = KnownPoseMapper(resolution=resolution)
    for k, scan in enumerate(log.scans):
        pose = Pose3.from_arrays(truth.positions[k], truth.quaternions[k])
        mounted: LaserScan = replace(scan, T_base_laser=T_base_laser, range_min=range_min)
        mapper.update(mounted, T_world_map.inverse() @ pose.to_pose2(), imu[k])
    return mapper.map().moved(T_world_map)
