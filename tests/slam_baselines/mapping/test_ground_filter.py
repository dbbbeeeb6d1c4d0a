"""Ground told from walls: only what is proven counts, and what stands upright gets proven."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu
from slam_baselines.mapping.ground_filter import GroundFilter, GroundFilterConfig
from slam_baselines.scan.leveling import LeveledScan, ScanLeveler, ScanPoints
from tests.slam_baselines.synthetic import Drive, wavy

Array = NDArray[np.float64]
NONE = np.zeros((0, 3))
LASER = np.array((0.0, 0.0, 0.32))


def leaning(pitch: float) -> LeveledScan:
    return LeveledScan(LASER, NONE, NONE, (-math.tan(pitch), 0.0), abs(pitch), 0.0)


def on_hills(tilt: float = 0.1, distance_traveled: float = 50.0) -> GroundFilter:
    """A filter that has met slopes, far enough from the start to know them."""
    ground_filter = GroundFilter(GroundFilterConfig(drift=1e-6))
    ground_filter.move(Pose2(distance_traveled), leaning(tilt))
    ground_filter.height = 0.0
    return ground_filter


def test_on_a_floor_every_hit_is_a_wall() -> None:
    ground_filter = GroundFilter()
    ground_filter.move(Pose2(), leaning(math.radians(0.3)))
    assert ground_filter.wall_slope == ground_filter.match_wall_slope == 0


def test_steeper_ground_met_asks_for_steeper_proof_when_matching() -> None:
    gentle, steep = on_hills(0.03), on_hills(0.15)
    assert 0 < gentle.match_wall_slope < steep.match_wall_slope <= round(100 * math.tan(math.radians(41)))


def test_what_could_be_ground_is_not_drawn_as_a_wall() -> None:
    """A hill may be steeper than all that the robot climbed; up to 45 degrees it is ground."""
    assert on_hills(0.03).wall_slope == on_hills(0.15).wall_slope == 100


def test_rocking_and_slipping_let_the_height_drift() -> None:
    smooth, rocking, slipping = (GroundFilter() for _ in range(3))
    for k in range(100):
        smooth.move(Pose2(0.05), leaning(-0.2))
        rocking.move(Pose2(0.05), leaning(-0.2 - 0.1 * math.sin(k)))
        slipping.move(Pose2(0.05), leaning(-0.2), registered=False)
    assert math.isclose(smooth.drift, 0.0015 * 5.0)
    assert rocking.drift > 1.5 * smooth.drift
    assert slipping.drift > 1.5 * smooth.drift
    # Standing still on a rocking robot moves nothing.
    for k in range(100):
        smooth.move(Pose2(), leaning(0.1 * math.sin(k)))
    assert math.isclose(smooth.drift, 0.0015 * 5.0)


def test_noise_of_one_reading_is_no_slope() -> None:
    ground_filter = GroundFilter()
    for k in range(200):
        ground_filter.move(Pose2(), leaning(math.radians(0.4) * (-1) ** k))
    assert ground_filter.match_wall_slope == 0


def test_height_follows_the_slope() -> None:
    ground_filter = GroundFilter()
    for _ in range(100):
        ground_filter.move(Pose2(0.1), leaning(-0.1))
    assert math.isclose(ground_filter.height, 10 * math.tan(0.1), rel_tol=1e-9)


def test_one_height_proves_nothing_two_heights_do() -> None:
    ground_filter = on_hills()
    low, high = (np.array(((6.0, 0.0, z),)) for z in (0.1, 0.75))
    assert ground_filter.observe(ScanPoints(LASER, low, NONE), Pose2())[0] < ground_filter.wall_slope
    assert ground_filter.observe(ScanPoints(LASER, high, NONE), Pose2())[0] >= ground_filter.wall_slope


def test_noise_of_the_attitude_proves_nothing() -> None:
    ground_filter, rng = on_hills(), np.random.default_rng(0)
    most = 0
    for _ in range(300):
        hit = np.array(((8.0, 0.0, 0.3 + 8.0 * rng.normal(0, math.radians(0.15))),))
        most = max(most, int(ground_filter.observe(ScanPoints(LASER, hit, NONE), Pose2())[0]))
    assert most < ground_filter.wall_slope


def test_what_rises_too_steeply_from_under_the_robot_is_a_wall_at_once() -> None:
    ground_filter = on_hills()
    hit = np.array(((0.6, 0.0, 0.32),))
    min_slope = ground_filter.observe(ScanPoints(LASER, hit, NONE), Pose2())[0]
    assert min_slope >= ground_filter.match_wall_slope


def test_a_beam_that_passes_low_in_front_proves_a_wall() -> None:
    ground_filter = on_hills()
    ground_filter.observe(ScanPoints(LASER, NONE, np.array(((6.0, 1.0, 0.0),))), Pose2())
    passing = np.array(((5.9, -3.0, 0.0),))
    ground_filter.observe(ScanPoints(np.array((5.9, 3.0, 0.0)), NONE, passing), Pose2())
    assert (
        ground_filter.observe(ScanPoints(LASER, np.array(((6.0, 0.0, 0.7),)), NONE), Pose2())[0]
        >= ground_filter.wall_slope
    )


def test_old_heights_are_believed_less_after_a_long_way() -> None:
    min_slope = []
    for drift in (0.0001, 0.02):
        ground_filter = GroundFilter(GroundFilterConfig(drift=drift))
        ground_filter.observe(ScanPoints(LASER, np.array(((6.0, 0.0, 0.1),)), NONE), Pose2())
        ground_filter.move(Pose2(20.0), leaning(0.0))
        high = ScanPoints(LASER, np.array(((6.0, 0.0, 0.75),)), NONE)
        min_slope.append(int(ground_filter.observe(high, Pose2())[0]))
    assert min_slope[1] < min_slope[0]


def test_hills_are_never_taken_for_walls_while_blocks_are() -> None:
    """Every hit of a drive at the true poses, against the terrain itself."""
    surface = wavy(1.5)
    drive = Drive(surface, 20.0, np.random.default_rng(3))
    leveler, ground_filter, last = ScanLeveler(), GroundFilter(), drive.truth[0].to_pose2()
    ground_filter.height = drive.truth[0].z
    ground = ground_filter.height - 0.13 - float(surface.height_at(last.x, last.y))
    assert abs(ground) < 0.02
    slope = surface.slope()
    false = found = walls = 0
    for scan, imu, truth in zip(drive.scans, drive.imus, drive.truth, strict=True):
        pose, level = truth.to_pose2(), leveler.level(scan, imu)
        ground_filter.move(last.inverse() @ pose, level)
        last = pose
        placed = level.transformed(pose, ground_filter.height)
        taken = ground_filter.observe(placed, pose) >= ground_filter.wall_slope
        cells = np.round((placed.hits[:, :2] - surface.origin) / surface.cell).astype(int)
        rows, cols = surface.shape[0] - 1 - cells[:, 1], cells[:, 0]
        near = np.array([slope[max(0, r - 3) : r + 4, max(0, c - 3) : c + 4].max(initial=0) > 0.8
                         for r, c in zip(rows, cols, strict=True)])  # fmt: skip
        false += int((taken & ~near).sum())
        walls += int(near.sum())
        found += int((taken & near).sum())
    assert walls > 10_000
    assert false <= 0.01 * (found + false)
    assert found > 0.15 * walls


def test_imu_free_scans_leave_the_ground_filter_alone() -> None:
    level = ScanLeveler().level(Drive(wavy(0.5, 101, 0.3), 0.05, np.random.default_rng(0)).scans[0], None)
    assert not level.leveled
    assert not GroundFilter.no_min_slope(3).any()
    assert (
        ScanLeveler()
        .level(Drive(wavy(0.5, 101, 0.3), 0.05, np.random.default_rng(0)).scans[0], Imu())
        .leveled
    )
