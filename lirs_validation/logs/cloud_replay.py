"""Replay of a log's point clouds, and the map of their horizontal beams."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from lirs_validation.experiment.mapper_under_test import MapperUnderTest, SensorReadings
from lirs_validation.metrics.alignment import associated
from lirs_validation.metrics.verdict import LostRule
from lirs_wct.errors import SourceError
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, PointCloud, Pose3, Trajectory
from lirs_wct.progress import Progress
from slam_baselines.mapping.known_pose import KnownPoseMapper

HORIZONTAL = np.tan(np.radians(1.5))
"""Slope of the beams that count as horizontal, up and down: rings of lidars are mostly 2 deg apart."""
BEAMS = 720
RANGE_MAX = 100.0
RESOLUTION = 0.05
"""Edge of the map's cell, meters."""


def replay_clouds(
    path: str,
    mapper: MapperUnderTest,
    clouds: Iterable[PointCloud],
    readings: Sequence[Imu | None],
    progress: Progress,
) -> tuple[LostRule, list[LaserScan]]:
    """Replay all clouds; return whether the place was kept, and each cloud's horizontal beams.

    Raises:
        SourceError: no cloud holds a valid point.
        MapperError: the mapper failed.
    """
    tracking, scans, points = LostRule(), list[LaserScan](), 0
    for cloud, imu in zip(clouds, readings, strict=True):
        estimate = mapper.observe(SensorReadings(imu=imu, cloud=cloud))
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
