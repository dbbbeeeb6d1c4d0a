"""Ground told from walls: only what is proven counts, and what stands upright gets proven."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu
from slam_baselines.mapping.ground_filter import Relief, ReliefConfig
from slam_baselines.scan.leveling import LevelledScan, ScanLeveller
from tests.slam_baselines.synthetic import Drive, wavy

Array = NDArray[np.float64]
NONE = np.zeros((0, 3))
LASER = np.array((0.0, 0.0, 0.32))


def leaning(pitch: float) -> LevelledScan:
    return LevelledScan(LASER, NONE, NONE, (-math.tan(pitch), 0.0), abs(pitch), 0.0)


def on_hills(tilt: float = 0.1, travelled: float = 50.0) -> Relief:
    """A relief that has met slopes, far enough from the start to know them."""
    relief = Relief(ReliefConfig(drift=1e-6))
    relief.move(Pose2(travelled), leaning(tilt))
    relief.height = 0.0
    return relief


def test_on_a_floor_every_hit_is_a_wall() -> None:
    relief = Relief()
    relief.move(Pose2(), leaning(math.radians(0.3)))
    assert relief.bound == relief.match_bound == 0


def test_steeper_ground_met_asks_for_steeper_proof() -> None:
    gentle, steep = on_hills(0.03), on_hills(0.15)
    assert 0 < gentle.bound < steep.bound <= round(100 * math.tan(math.radians(41)))


def test_noise_of_one_reading_is_no_slope() -> None:
    relief = Relief()
    for k in range(200):
        relief.move(Pose2(), leaning(math.radians(0.4) * (-1) ** k))
    assert relief.match_bound == 0


def test_height_follows_the_slope() -> None:
    relief = Relief()
    for _ in range(100):
        relief.move(Pose2(0.1), leaning(-0.1))
    assert math.isclose(relief.height, 10 * math.tan(0.1), rel_tol=1e-9)


def test_one_height_proves_nothing_two_heights_do() -> None:
    relief = on_hills()
    low, high = (np.array(((6.0, 0.0, z),)) for z in (0.1, 0.75))
    assert relief.observe(LASER, low, NONE, Pose2())[0] < relief.bound
    assert relief.observe(LASER, high, NONE, Pose2())[0] >= relief.bound


def test_noise_of_the_attitude_proves_nothing() -> None:
    relief, rng = on_hills(), np.random.default_rng(0)
    most = 0
    for _ in range(300):
        hit = np.array(((8.0, 0.0, 0.3 + 8.0 * rng.normal(0, math.radians(0.15))),))
        most = max(most, int(relief.observe(LASER, hit, NONE, Pose2())[0]))
    assert most < relief.bound


def test_what_rises_too_steeply_from_under_the_robot_is_a_wall_at_once() -> None:
    relief = on_hills()
    assert relief.observe(LASER, np.array(((0.6, 0.0, 0.32),)), NONE, Pose2())[0] >= relief.bound


def test_a_beam_that_passes_low_in_front_proves_a_wall() -> None:
    relief = on_hills()
    relief.observe(LASER, NONE, np.array(((6.0, 1.0, 0.0),)), Pose2())
    passing = np.array(((5.9, -3.0, 0.0),))
    relief.observe(np.array((5.9, 3.0, 0.0)), NONE, passing, Pose2())
    assert relief.observe(LASER, np.array(((6.0, 0.0, 0.7),)), NONE, Pose2())[0] >= relief.bound


def test_old_heights_are_believed_less_after_a_long_way() -> None:
    steepness = []
    for drift in (0.0001, 0.02):
        relief = Relief(ReliefConfig(drift=drift))
        relief.observe(LASER, np.array(((6.0, 0.0, 0.1),)), NONE, Pose2())
        relief.move(Pose2(20.0), leaning(0.0))
        steepness.append(int(relief.observe(LASER, np.array(((6.0, 0.0, 0.75),)), NONE, Pose2())[0]))
    assert steepness[1] < steepness[0]


def test_hills_are_never_proven_while_blocks_are() -> None:
    """Every hit of a drive at the true poses, against the terrain itself."""
    surface = wavy(1.5)
    drive = Drive(surface, 20.0, np.random.default_rng(3))
    leveller, relief, last = ScanLeveller(), Relief(), drive.truth[0].to_pose2()
    relief.height = drive.truth[0].z
    ground = relief.height - 0.13 - float(surface.height_at(last.x, last.y))
    assert abs(ground) < 0.02
    slope = surface.slope()
    false = proven = walls = 0
    for scan, imu, truth in zip(drive.scans, drive.imus, drive.truth, strict=True):
        pose, level = truth.to_pose2(), leveller.level(scan, imu)
        relief.move(last.inverse() @ pose, level)
        last = pose
        origin, hits, free = level.placed(pose, relief.height)
        steep = relief.observe(origin, hits, free, pose) >= relief.bound
        cells = np.round((hits[:, :2] - surface.origin) / surface.cell).astype(int)
        rows, cols = surface.shape[0] - 1 - cells[:, 1], cells[:, 0]
        near = np.array([slope[max(0, r - 3) : r + 4, max(0, c - 3) : c + 4].max(initial=0) > 0.8
                         for r, c in zip(rows, cols, strict=True)])  # fmt: skip
        false += int((steep & ~near).sum())
        walls += int(near.sum())
        proven += int((steep & near).sum())
    assert walls > 10_000
    assert false <= 0.01 * (proven + false)
    assert proven > 0.2 * walls


def test_imu_free_scans_leave_the_relief_alone() -> None:
    level = ScanLeveller().level(Drive(wavy(0.5, 101, 0.3), 0.05, np.random.default_rng(0)).scans[0], None)
    assert not level.levelled
    assert not Relief.unproven(3).any()
    assert (
        ScanLeveller()
        .level(Drive(wavy(0.5, 101, 0.3), 0.05, np.random.default_rng(0)).scans[0], Imu())
        .levelled
    )
