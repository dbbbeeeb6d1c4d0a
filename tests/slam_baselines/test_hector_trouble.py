"""Difficult drives: sharp turns, slides on slopes, blind scans, wrong or missing odometry."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lirs_validation.logs.read_log import read_reference
from lirs_validation.metrics.mapped_log import reference_errors
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.geometry.pose import Pose2, wrap_angle
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.hector import HectorMapper
from tests.slam_baselines.synthetic import Drive, drive_room, loop, ranges_to, room_scan, wavy


def test_a_jump_is_found_again_or_admitted() -> None:
    rng = np.random.default_rng(0)
    near, far = HectorMapper(), HectorMapper()
    for mapper in (near, far):
        for k in range(5):
            mapper.update(room_scan(Pose2(), 0.1 * k, rng), Pose2(), None)
    for k in range(5, 20):
        near.update(room_scan(Pose2(0.3, 0.2, 0.35), 0.1 * k, rng), Pose2(), None)
        blind = room_scan(Pose2(), 0.1 * k, rng)
        far.update(replace(blind, ranges=rng.uniform(0.5, 2.5, 361).astype(np.float32)), Pose2(), None)
    assert not near.lost
    np.testing.assert_allclose(near.trajectory().xy[-1], (0.3, 0.2), atol=0.03)
    assert far.lost
    assert far.stats.lost > 0


@pytest.mark.parametrize("turn", [-0.45, 0.45])
def test_a_sharp_turn_between_two_scans_needs_no_odometry(turn: float) -> None:
    rng, mapper = np.random.default_rng(0), HectorMapper()
    for k in range(5):
        mapper.update(room_scan(Pose2(), 0.2 * k, rng), None, None)
    for k in range(5, 12):
        there = Pose2(0.1 * (k - 4), 0.05, turn * (k - 4))
        estimate = mapper.update(room_scan(there, 0.2 * k, rng), None, None)
        assert there.distance(estimate) < 0.05
        assert abs(wrap_angle(there.yaw - estimate.yaw)) < 0.02
    assert not mapper.lost


def test_it_says_when_it_is_lost_and_when_it_is_back() -> None:
    """Scans of nowhere make it lost; they do not enter the map, so the room is known again at once."""
    rng, mapper = np.random.default_rng(0), HectorMapper()
    drive_room(mapper, n=60)
    before, home = mapper.map(), mapper.trajectory().pose2(-1)
    room = room_scan(loop(60)[-1], 0.0, rng)
    for k in range(15):
        nowhere = rng.uniform(0.5, 2.5, 361).astype(np.float32)
        mapper.update(replace(room, ranges=nowhere, stamp=100.0 + k), home, None)
        assert mapper.lost == (k + 1 >= mapper.config.lost_after)
    np.testing.assert_array_equal(mapper.map().log_odds, before.log_odds)
    for k in range(3):
        mapper.update(replace(room, stamp=200.0 + k), home, None)
    assert not mapper.lost
    assert mapper.stats.lost == 6


def test_memory_follows_the_area_and_not_the_time() -> None:
    once, often = HectorMapper(), HectorMapper()
    drive_room(once, n=80)
    rng, path = np.random.default_rng(0), loop(80)
    for k in range(5 * 80):
        pose = path[k % 80]
        often.update(room_scan(pose, 0.1 * k, rng), path[0].inverse() @ pose, None)
    assert often.stats.memory == once.stats.memory
    assert often.stats.received == 400


def test_stamps_may_go_backwards() -> None:
    mapper, rng = HectorMapper(), np.random.default_rng(0)
    for stamp in (0.0, 2.0, 1.0, 2.0):
        mapper.update(room_scan(Pose2(), stamp, rng), Pose2(), None)
    assert mapper.trajectory().stamps.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(("ground_filter", "slide"), [(2.0, 2.0), (1.5, 4.0)])
def test_sliding_in_turns_on_a_slope_does_little_harm(ground_filter: float, slide: float) -> None:
    """The wheels see nothing of it, so dead reckoning alone goes far astray; by the median of three seeds."""
    shares = list[float]()
    for seed in (1, 2, 3):
        drive = Drive(wavy(ground_filter), 24.0, np.random.default_rng(seed), slide=slide)
        mapper, T = HectorMapper(), drive.truth[0].to_pose2()
        for scan, odometry, imu in zip(drive.scans, drive.odometry, drive.imus, strict=True):
            mapper.update(scan, odometry, imu)
        true = np.array([(p.x, p.y) for p in drive.truth])
        reckoned = np.array([(p.x, p.y) for p in (T @ step for step in drive.odometry)])
        error, astray = (
            np.sqrt(((path - true) ** 2).sum(axis=1).mean())
            for path in (mapper.trajectory().moved(T).xy, reckoned)
        )
        assert astray > 0.5
        assert mapper.stats.lost == 0
        shares.append(error / astray)
    assert np.median(shares) < 0.2


def test_odometry_that_stalls_and_catches_up_does_no_harm() -> None:
    """It stands for a while and then gives the whole way at once: scans know better."""
    rng, path, mapper = np.random.default_rng(0), loop(120), HectorMapper()
    errors: list[float] = []
    for k, pose in enumerate(path):
        seen = path[0].inverse() @ path[k - k % 6]
        estimate = mapper.update(room_scan(pose, 0.2 * k, rng), seen, None)
        errors.append((path[0].inverse() @ pose).distance(estimate))
    assert max(errors) < 0.12
    assert errors[-1] < 0.04
    assert not mapper.lost


SECONDS, RADIUS = 300, 1.5


@pytest.mark.parametrize(("rate", "speed"), [(5.0, 0.5), (5.0, 0.3)])
def test_five_minutes_of_circles_teach_nothing_wrong(rate: float, speed: float) -> None:
    """Odometry 3 % long and turning by itself; with plain forgetting a gain grew beyond 2 within 200 s."""
    rng, mapper, odometry = np.random.default_rng(1), HectorMapper(), Pose2()
    poses = [circle(speed * k / rate) for k in range(int(SECONDS * rate))]
    for k, (before, pose) in enumerate(zip([poses[0], *poses], poses, strict=False)):
        step = before.inverse() @ pose
        slip = Pose2(
            1.03 * step.x + rng.normal(0, 0.001), step.y, step.yaw + 0.02 * step.x + rng.normal(0, 0.002)
        )
        odometry = odometry @ slip if k else odometry
        found = mapper.update(room_scan(pose, k / rate, rng, beams=181), odometry, None)
        assert (poses[0] @ found).distance(pose) < 0.06
        calibration = mapper.reckoning.calibration
        assert max(map(abs, calibration.gain)) < 0.1
        p, q, r = calibration.covariance
        assert p > 0
        assert p * r > q * q
    straight = calibration.correct(Pose2(1.0))
    assert straight.distance(Pose2(1.0)) < 0.05


def circle(meters: float) -> Pose2:
    """Pose after meters of a circle through the room."""
    a = meters / RADIUS
    return Pose2(RADIUS * math.sin(a), RADIUS * (1 - math.cos(a)) - 0.5, a)


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
@pytest.mark.parametrize("skipped", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])
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


def test_nothing_in_a_scan_breaks_it() -> None:
    mapper, rng = HectorMapper(), np.random.default_rng(0)
    good = room_scan(Pose2(), 0.0, rng)
    odd = np.array((np.nan, np.inf, -np.inf, 0.0, -1.0, 1e30), np.float32)
    for k, ranges in enumerate(
        (np.zeros(0, np.float32), odd, good.ranges, np.full(361, np.nan, np.float32), odd, good.ranges)
    ):
        for imu in (None, Imu(0.1, -0.1)):
            pose = mapper.update(replace(good, ranges=ranges, stamp=float(k)), None, imu)
            assert np.isfinite(pose.as_array()).all()
    assert mapper.map().known.any()
    assert len(mapper.trajectory()) == 6


def test_scans_that_fit_nowhere_on_a_floor_leave_the_start_to_the_odometry() -> None:
    """As of slopes far away, which a floor hides; the refined start once took every match."""
    mapper, rng, level = HectorMapper(), np.random.default_rng(0), Imu()
    room, moved = room_scan(Pose2(), 0.0, rng), [Pose2(0.05 * k) for k in range(120)]
    for k, pose in enumerate(moved):
        anywhere = rng.uniform(2.0, 6.0, len(room.ranges)).astype(np.float32)
        mapper.update(replace(room, ranges=anywhere, stamp=0.1 * k), pose, level)
    assert mapper.stats.counts["second_looks"] == 1
    np.testing.assert_allclose(mapper.trajectory().xy, [(pose.x, pose.y) for pose in moved], atol=1e-9)
