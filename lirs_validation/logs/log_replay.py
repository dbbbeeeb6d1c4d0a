"""Mapper of a log, its inertial readings, and the replay of its scans or point clouds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lirs_validation.experiment.mapper_under_test import (
    LocalMapper,
    MapperProcess,
    MapperUnderTest,
    SensorReadings,
    needs_process,
)
from lirs_validation.map_config import MapConfig
from lirs_validation.metrics.alignment import MAX_GAP, associated
from lirs_validation.record.verdict import LostRule
from lirs_wct import (
    ConfigError,
    Imu,
    LaserScan,
    OccupancyGrid,
    PointCloud,
    Pose3,
    SourceError,
    Trajectory,
    unknown_name,
)
from lirs_wct.formats import carmen_log, drive_files
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.progress import Progress
from lirs_wct.sources.source import is_bag
from slam_baselines.map_builder import KnownPoseMapper
from slam_baselines.mapper import (
    ALL_CLOUD_MAPPERS,
    MAPPERS,
    OWN_CLOUD_MAPPERS,
    CloudMapper,
    Mapper,
    make_cloud_mapper,
    make_mapper,
    read_parameters,
)
from slam_baselines.warm_up import warm_up

WARM_UP_CONFIG = {"gmapping": {"particles": 4}}
"""Kernels need no more particles than these to be compiled."""


@contextmanager
def log_mapper(config: MapConfig) -> Iterator[MapperUnderTest]:
    """Give the mapper of a log.

    Foreign code works in its own process, which ends with the block.

    Raises:
        ConfigError: there is no such mapper or parameter, or it reads point clouds and the log is no bag.
        MapperError: the process cannot be started.
    """
    with closing(_start(config)) as mapper:
        if mapper.reads_clouds and not is_bag(Path(config.log)):
            raise ConfigError(
                f"{config.log}: mapper {config.mapper} reads point clouds, a CARMEN log holds planar scans; "
                f"legal: {', '.join(MAPPERS)}"
            )
        yield mapper


def _start(config: MapConfig) -> MapperUnderTest:
    if not needs_process(config.mapper):
        return LocalMapper(_make(config), config.mapper, config.attitude)
    if config.resolution is not None and config.mapper not in ALL_CLOUD_MAPPERS:
        raise ConfigError(f"resolution can be given for {', '.join(MAPPERS)} only")
    return MapperProcess(config)


def _make(config: MapConfig) -> Mapper | CloudMapper:
    if config.mapper in OWN_CLOUD_MAPPERS:
        return make_cloud_mapper(config.mapper, seed=config.seed, **read_parameters(config.parameters))
    given: dict[str, Any] = {} if config.resolution is None else {"resolution": config.resolution}
    given |= read_parameters(config.parameters)
    if config.mapper not in MAPPERS:
        raise unknown_name("mapper", config.mapper, [*MAPPERS, *ALL_CLOUD_MAPPERS, "module:name of your own"])
    return make_mapper(config.mapper, seed=config.seed, **given)


def check_log(config: MapConfig, mapper: MapperUnderTest, log: LaserLog) -> None:
    """Check that a log holds the data that the mapper needs.

    Raises:
        SourceError: nothing was seen in it, or it lacks odometry or inertial readings that the mapper needs.
    """
    if mapper.reads_clouds:
        if mapper.reads_inertial and log.inertial is None:
            raise SourceError(
                f"{config.log}: {config.mapper} needs inertial readings: name their topic by --imu-topic"
            )
        return
    if not any(scan.hits.any() for scan in log.scans):
        raise SourceError(f"{config.log}: none of its {len(log.scans)} scans met anything within range")
    if mapper.requires_odometry and log.odometry[0] is None:
        raise SourceError(
            f"{config.log}: holds no odometry (or one that never changes), {config.mapper} needs it; "
            "hector maps without"
        )


def warm_up_log_mapper(config: MapConfig) -> None:
    """Compile a mapper's kernels; one of your own is not warmed up."""
    if config.mapper in MAPPERS:
        warm_up(config.mapper, **WARM_UP_CONFIG.get(config.mapper, {}))


def inertial_readings(config: MapConfig, log: LaserLog) -> list[Imu | None]:
    """Return the inertial reading at each scan; None without one within 0.02 s.

    Raises:
        SourceError: the file cannot be used, or has no reading at any scan.
    """
    readings: list[Imu | None] = [None] * len(log.stamps)
    held = log.imu if config.imu is None else drive_files.read_imu(Path(config.imu))
    if not held:
        return readings
    found = sorted(held, key=lambda reading: reading.stamp)
    stamps = np.array([reading.stamp for reading in found])
    for scan, reading in zip(*associated(log.stamps, stamps), strict=True):
        readings[scan] = found[reading]
    if not any(readings):
        raise SourceError(
            f"{config.imu or config.imu_topic}: other stamps: none of its {len(found)} readings lies "
            f"within {MAX_GAP} s of one of the log's {len(log.stamps)} scans"
        )
    return readings


def with_recorded_mount(config: MapConfig, log: LaserLog) -> LaserLog:
    """Return the log with the laser's mount of the comment, height and tilt included."""
    T_base_laser = carmen_log.read_mount(Path(config.log))
    if T_base_laser is None:
        return log
    return replace(log, scans=tuple(replace(scan, T_base_laser=T_base_laser) for scan in log.scans))


def replay(
    config: MapConfig,
    mapper: MapperUnderTest,
    log: LaserLog,
    readings: Sequence[Imu | None],
    progress: Progress,
) -> LostRule:
    """Replay the log with inertial readings; return the lost rule's state.

    Raises:
        SourceError: the log lacks data that the mapper needs.
        MapperError: it failed.
    """
    scans, tracking = len(log.scans), LostRule()
    fed = zip(log.scans, log.odometry, readings, strict=True)
    for k, (scan, odometry, imu) in enumerate(fed):
        try:
            estimate = mapper.observe(SensorReadings(scan, odometry, imu))
        except ConfigError as error:
            raise SourceError(f"{config.log}: {error}") from error
        tracking.observe(scan.stamp, estimate.lost)
        progress("map", (k + 1) / scans)
    return tracking


HORIZONTAL = np.tan(np.radians(1.5))
"""Slope of the beams that count as horizontal, up and down: rings of lidars are mostly 2 deg apart."""
BEAMS = 720
RANGE_MAX = 100.0
RESOLUTION = 0.05
"""Edge of the map's cell, meters."""


def replay_clouds(
    path: str, mapper: MapperUnderTest, log: LaserLog, readings: Sequence[Imu | None], progress: Progress
) -> tuple[LostRule, list[LaserScan]]:
    """Replay all clouds; return whether the place was kept, and each cloud's horizontal beams.

    Raises:
        SourceError: no cloud holds a valid point.
        MapperError: the mapper failed.
    """
    tracking, scans, points, before = LostRule(), list[LaserScan](), 0, -np.inf
    for cloud, odometry, imu in zip(log.clouds or (), log.odometry, readings, strict=True):
        inertial = None if log.inertial is None else log.inertial.between(before, cloud.stamp)
        before = cloud.stamp
        estimate = mapper.observe(SensorReadings(None, odometry, imu, cloud, inertial))
        tracking.observe(cloud.stamp, estimate.lost)
        points += len(cloud)
        scans.append(horizontal_scan(cloud))
        progress("map", len(scans) / len(readings))
    if not points:
        raise SourceError(f"{path}: none of its {len(scans)} point clouds holds a valid point")
    return tracking, scans


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
    made = KnownPoseMapper(resolution=resolution or RESOLUTION)
    stamps = np.array([scan.stamp for scan in scans])
    for k, pose in zip(*associated(stamps, trajectory.stamps), strict=True):
        made.update(scans[k], trajectory.pose2(int(pose)), None)
    return made.map()
