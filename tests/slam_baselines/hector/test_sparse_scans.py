"""Scans a meter apart: far walls are dots in a single scan, and are drawn as walls nevertheless."""

from pathlib import Path

import numpy as np
import pytest

from lirs_validation.logs.reference import read_reference
from lirs_validation.metrics.log_accuracy import reference_errors
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.geometry.pose import Pose2, wrap_angle
from lirs_wct.geometry.scan import LaserScan
from slam_baselines.hector.mapper import HectorMapper
from tests.slam_baselines.synthetic import ranges_to

HALL = np.array(
    ((-8.0, -6.0, 14.0, -6.0), (14.0, -6.0, 14.0, 9.0), (14.0, 9.0, -8.0, 9.0), (-8.0, 9.0, -8.0, -6.0))
)


def hall_scan(pose: Pose2, stamp: float, rng: np.random.Generator) -> LaserScan:
    """A scan with a beam every degree: on a wall 8 m away hits are 14 cm apart, nearly three cells."""
    start, step = -np.pi / 2, np.pi / 180
    r = ranges_to(HALL, pose, start + step * np.arange(181)) + rng.normal(0, 0.01, 181)
    return LaserScan(r.astype(np.float32), start, step, 0.05, 80.0, stamp)


def far_wall(spacing: float) -> float:
    """Return the share of 10 cm stretches of the far wall that are drawn by two scans, meters apart."""
    rng, mapper = np.random.default_rng(0), HectorMapper()
    for k in range(2):
        pose = Pose2(k * spacing)
        mapper.update(hall_scan(pose, 1.0 * k, rng), pose, None)
    points = mapper.map().occupied_points()
    there = points[(abs(points[:, 0] - 14.0) < 0.15) & (abs(points[:, 1]) < 4.0)]
    return len(np.unique(np.floor(there[:, 1] / 0.1))) / 80


def test_a_wall_is_drawn_without_gaps_where_no_other_scan_fills_them() -> None:
    assert far_wall(1.0) > 0.95
    assert far_wall(0.35) < 0.75


@pytest.mark.shared
@pytest.mark.parametrize("skipped", [0.0, 0.5])
def test_csail_thinned_to_a_scan_a_meter(shared_data: Path, skipped: float) -> None:
    """Or half a radian; where hits are left alone, the map breaks, and the error is 17 to 20 m."""
    folder = shared_data / "logs" / "csail"
    log, mapper = read_carmen(folder / "mit-csail.clf.gz"), HectorMapper()
    meters, radians, last = 1.0 - skipped, 0.0, log.odometry[0]
    for scan, odometry in zip(log.scans, log.odometry, strict=True):
        meters += last.distance(odometry)
        radians += abs(wrap_angle(odometry.yaw - last.yaw))
        last = odometry
        if meters >= 1.0 or radians >= 0.5:
            mapper.update(scan, odometry, None)
            meters = radians = 0.0
    errors = reference_errors(mapper.trajectory(), read_reference(folder / "reference_poses.log.gz"))
    assert np.sqrt((errors.position**2).mean()) < 1.0
