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
from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.imu_csv import read_imu
from lirs_wct.formats.tum import read_tum
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
    build: dict[str, Any] = {
        key: tuple(v) if isinstance(v, list) else v for key, v in held.pop("build").items()
    }
    if build.get("origin") is not None:
        build["origin"] = Pose2(**build["origin"])
    if build.get("texture") is not None:
        build["texture"] = Path(build["texture"])
    unknown = (set(held) - {f.name for f in fields(RunConfig)}) | (
        set(build) - {f.name for f in fields(SourceOptions)}
    )
    if unknown:
        raise SourceError(f"{entry['name']}: options unknown to this version: {', '.join(sorted(unknown))}")
    return RunConfig(**held, build=SourceOptions(**build))


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
