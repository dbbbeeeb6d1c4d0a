"""Leveled scans have the heights that geometry gives them; hits are interpolated along walls alone."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.leveling import ScanLeveler, ScanPoints, interpolate_hits, voxel_filter

ANGLE = st.floats(-0.4, 0.4)
MOUNT = Pose3.from_rpy(0.22, -0.05, 0.32, 0.02, -0.03, 0.1)


def scan_of(ranges: list[float], mount: Pose3 = MOUNT) -> LaserScan:
    return LaserScan(np.array(ranges, np.float32), -1.0, 0.5, 0.1, 20.0, 0.0, mount)


@settings(max_examples=60, deadline=None)
@given(ANGLE, ANGLE, st.lists(st.floats(0.2, 19.0), min_size=1, max_size=9))
def test_equals_the_rotation_written_out(roll: float, pitch: float, ranges: list[float]) -> None:
    scan = scan_of(ranges)
    level = ScanLeveler().level(scan, Imu(roll, pitch))
    beams = np.stack((np.cos(scan.angles), np.sin(scan.angles), 0 * scan.angles), axis=-1)
    T = Pose3.from_rpy(0, 0, 0, roll, pitch, 0) @ MOUNT
    np.testing.assert_allclose(level.hits, T.apply(beams * scan.ranges[:, None].astype(float)), atol=1e-9)
    np.testing.assert_allclose(level.origin, T.position, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(ANGLE, ANGLE)
def test_beams_that_meet_level_ground_have_its_height(roll: float, pitch: float) -> None:
    T = Pose3.from_rpy(0, 0, 0.13, roll, pitch, 0) @ Pose3.from_rpy(0.2, 0, 0.32, 0, 0, 0)
    angles = -1.0 + 0.5 * np.arange(5)
    down = (np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=-1) @ T.rotation.T)[:, 2]
    ranges = np.where(down < -1e-3, -T.z / np.minimum(down, -1e-3), np.inf)
    level = ScanLeveler(max_range=500.0).level(
        LaserScan(
            ranges.astype(np.float32), -1.0, 0.5, 0.1, 500.0, 0.0, Pose3.from_rpy(0.2, 0, 0.32, 0, 0, 0)
        ),
        Imu(roll, pitch),
    )
    np.testing.assert_allclose(level.hits[:, 2], -0.13, atol=2e-4)


def test_slope_of_the_ground_is_that_of_the_plane_the_robot_stands_on() -> None:
    roll, pitch = 0.1, -0.2
    level = ScanLeveler().level(scan_of([1.0]), Imu(roll, pitch))
    plane = Pose3.from_rpy(0, 0, 0, roll, pitch, 0).rotation
    for ahead, left in ((1.0, 0.0), (0.0, 1.0)):
        x, y, z = plane @ (ahead, left, 0.0)
        assert z == pytest.approx(level.ground_slope[0] * x + level.ground_slope[1] * y)


def test_odd_ranges_are_no_hits() -> None:
    level = ScanLeveler(clear_range=5.0).level(
        scan_of([math.nan, math.inf, -math.inf, 0.05, 25.0, 2.0]), None
    )
    assert (len(level.hits), len(level.free)) == (1, 2)
    assert not level.leveled
    assert np.isfinite(level.hits).all()
    np.testing.assert_allclose(np.linalg.norm(level.free - level.origin, axis=1), 5.0)


def test_transformed_moves_by_the_planar_pose_and_the_height() -> None:
    level = ScanLeveler().level(scan_of([1.0, 2.0]), None)
    pose = Pose2(1.0, 2.0, 0.7)
    origin, hits, free = level.transformed(pose, 0.4)
    np.testing.assert_allclose(hits[:, :2], pose.apply(level.hits[:, :2]))
    np.testing.assert_allclose(hits[:, 2], level.hits[:, 2] + 0.4)
    assert origin[2] == pytest.approx(level.origin[2] + 0.4)
    assert free.shape == (0, 3)


SPACING = 0.05


def interpolated(hits, slopes=None):
    hits = np.array([(*hit, 0.5)[:3] for hit in hits], dtype=np.float64).reshape(-1, 3)
    slopes = np.zeros(len(hits), np.uint8) if slopes is None else np.array(slopes, np.uint8)
    scan = ScanPoints(np.zeros(3), hits, np.empty((0, 3)))
    out, found = interpolate_hits(scan, slopes, SPACING)
    return out.hits, found


def wall(angles, x=8.0):
    """Hits of beams on a wall across, at x."""
    return [(x, x * math.tan(a)) for a in np.radians(angles)]


def test_a_wall_has_no_gaps_left():
    hits, slopes = interpolated(wall(range(-20, 21)), slopes=range(41))
    assert len(hits) == len(slopes) > 100
    assert np.allclose(hits[:, 0], 8.0)
    assert (np.diff(hits[:, 1]) > 0).all()
    assert np.diff(hits[:, 1]).max() <= SPACING + 1e-9
    assert (np.diff(slopes.astype(int)) >= 0).all(), "between two hits the smaller of their slopes"


def test_no_wall_is_drawn_across_a_doorway_a_step_or_between_two_things():
    doorway = wall(range(-20, -8)) + wall(range(8, 21))
    hits, _ = interpolated(doorway)
    assert not (abs(hits[:, 1]) < 1.0).any()
    near_and_far = [(8.0, y) for y in (-0.4, -0.2, 0.0)] + [(8.7, y) for y in (0.1, 0.3, 0.5)]
    hits, _ = interpolated(near_and_far)
    assert not ((hits[:, 0] > 8.01) & (hits[:, 0] < 8.69)).any()
    trees = [(8.0, 0.0), (8.6, 0.5), (8.0, 1.0), (8.6, 1.5)]
    assert len(interpolated(trees)[0]) == 4


def test_few_hits_are_no_surface():
    assert len(interpolated([])[0]) == 0
    assert len(interpolated(wall((0, 1)))[0]) == 2


def test_the_voxel_filter_keeps_one_point_a_square() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (500, 3))
    thin = voxel_filter(points, 0.5, 1000)
    cells = {tuple(c) for c in np.floor(thin[:, :2] / 0.5).astype(int).tolist()}
    assert len(thin) == len(cells) == 16
    assert len(voxel_filter(points, 0.05, 40)) <= 40
