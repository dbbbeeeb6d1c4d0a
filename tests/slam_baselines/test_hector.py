"""The whole method: a room, a hill, bad input, real logs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lirs_validation.map_metrics import agreement, false_occupied
from lirs_validation.relations import read_relations, relation_errors
from lirs_wct.errors import ConfigError
from lirs_wct.formats.carmen import read_carmen
from lirs_wct.pose import Pose2, wrap_angle
from lirs_wct.scan import Imu, LaserScan
from slam_baselines.hector import HectorConfig, HectorMapper
from slam_baselines.known_pose import KnownPoseMapper
from slam_baselines.mapper import make_mapper
from slam_baselines.registration import RegistrationConfig
from slam_baselines.scan_matching import MatchConfig
from tests.slam_baselines.synthetic import Drive, loop, room_scan, wavy

Array = NDArray[np.float64]


def drive_room(mapper: HectorMapper, *, odometry: bool = True, n: int = 240) -> Array:
    """Drive the loop; return errors (n, 3) in the map frame."""
    rng = np.random.default_rng(0)
    path = loop(n)
    errors, walked = [], Pose2()
    for k, pose in enumerate(path):
        if k:
            step = path[k - 1].inverse() @ pose
            walked = walked @ Pose2(step.x * 1.05, step.y, step.yaw * 1.03)
        estimate = mapper.update(room_scan(pose, 0.1 * k, rng), walked if odometry else None, None)
        error = (path[0].inverse() @ pose).inverse() @ estimate
        errors.append(error.as_array())
    return np.array(errors)


@pytest.mark.parametrize("odometry", [True, False])
def test_a_drive_through_a_room(odometry: bool) -> None:
    mapper = HectorMapper()
    errors = drive_room(mapper, odometry=odometry)
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.05
    assert np.abs(errors[:, 2]).max() < 0.02
    assert not mapper.lost
    assert len(mapper.trajectory()) == 240
    stats = mapper.stats
    assert (stats.received, stats.used, stats.lost) == (240, 239, 0)
    assert 0 < stats.ms_p50 <= stats.ms_p95 <= stats.ms_max


def test_the_map_of_the_room_is_that_of_the_true_poses() -> None:
    mapper, known, rng = HectorMapper(), KnownPoseMapper(), np.random.default_rng(0)
    drive_room(mapper)
    path = loop(240)
    for k, pose in enumerate(path):
        known.update(room_scan(pose, 0.1 * k, rng), path[0].inverse() @ pose, None)
    score = agreement(mapper.map(), known.map())
    assert score.f1 is not None
    assert score.f1 > 0.97


def test_the_same_again_gives_the_same_bytes() -> None:
    one, two = HectorMapper(), HectorMapper()
    np.testing.assert_array_equal(drive_room(one, n=80), drive_room(two, n=80))
    np.testing.assert_array_equal(one.map().log_odds, two.map().log_odds)


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


def test_scans_that_could_not_be_matched_are_counted() -> None:
    mapper, rng = HectorMapper(), np.random.default_rng(0)
    good = room_scan(Pose2(), 0.0, rng)
    blind = replace(good, ranges=np.full(361, np.inf, np.float32))
    for k, scan in enumerate((good, blind, good, blind)):
        mapper.update(replace(scan, stamp=float(k)), Pose2(), None)
    stats = mapper.stats
    assert (stats.received, stats.used) == (4, 1)
    assert list(stats.skipped.values()) == [2]


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


def test_stamps_may_go_backwards() -> None:
    mapper, rng = HectorMapper(), np.random.default_rng(0)
    for stamp in (0.0, 2.0, 1.0, 2.0):
        mapper.update(room_scan(Pose2(), stamp, rng), Pose2(), None)
    assert mapper.trajectory().stamps.tolist() == [0.0, 1.0, 2.0]


def test_hilly_ground() -> None:
    surface = wavy(1.5)
    drive = Drive(surface, 24.0, np.random.default_rng(1))
    mapper, known = HectorMapper(), KnownPoseMapper()
    T = drive.truth[0].to_pose2()
    for scan, odometry, imu, truth in zip(drive.scans, drive.odometry, drive.imus, drive.truth, strict=True):
        mapper.update(scan, odometry, imu)
        known.update(scan, T.inverse() @ truth.to_pose2(), imu)
    estimate = mapper.trajectory().moved(T)
    error = np.linalg.norm(estimate.xy - np.array([(p.x, p.y) for p in drive.truth]), axis=1)
    built, true = mapper.map().moved(T), known.map().moved(T)
    assert np.sqrt((error**2).mean()) < 0.1
    for grid in (built, true):
        false = false_occupied(grid, surface, None)
        assert false is not None
        assert false <= 0.05
    assert true.occupied.sum() > 100
    f1 = agreement(built, true).f1
    assert f1 is not None
    assert f1 > 0.85


@pytest.mark.parametrize(("relief", "slide"), [(2.0, 2.0), (1.5, 4.0)])
def test_sliding_in_turns_on_a_slope_does_no_harm(relief: float, slide: float) -> None:
    """The wheels see nothing of it, so dead reckoning alone goes far astray."""
    drive = Drive(wavy(relief), 24.0, np.random.default_rng(1), slide=slide)
    mapper, T = HectorMapper(), drive.truth[0].to_pose2()
    for scan, odometry, imu in zip(drive.scans, drive.odometry, drive.imus, strict=True):
        mapper.update(scan, odometry, imu)
    true = np.array([(p.x, p.y) for p in drive.truth])
    reckoned = np.array([(p.x, p.y) for p in (T @ step for step in drive.odometry)])
    error = np.linalg.norm(mapper.trajectory().moved(T).xy - true, axis=1)
    assert np.sqrt(((reckoned - true) ** 2).sum(axis=1).mean()) > 0.5
    assert np.sqrt((error**2).mean()) < 0.1
    assert mapper.stats.lost == 0


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


def test_unknown_names_list_the_legal_ones() -> None:
    with pytest.raises(ConfigError, match=r"unknown mapper 'hektor'; legal: .*hector"):
        make_mapper("hektor")
    with pytest.raises(
        ConfigError, match=r"unknown parameter of hector 'resolution'; legal: .*map_resolution"
    ):
        make_mapper("hector", resolution=0.1)
    assert isinstance(make_mapper("hector", map_resolution=0.1), HectorMapper)


@pytest.mark.parametrize(
    "bad",
    [
        {"map_resolution": 0.0},
        {"map_multi_res_levels": 0},
        {"map_update_distance_thresh": -1.0},
        {"lost_score": 0.9},
        {"registration": RegistrationConfig(match=MatchConfig(iterations=(3,)))},
    ],
)
def test_illegal_config(bad: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        HectorConfig(**bad)  # type: ignore[arg-type]


@pytest.mark.shared
def test_intel_beginning(shared_data: Path) -> None:
    folder = shared_data / "logs" / "intel"
    log, mapper = read_carmen(folder / "intel.clf.gz"), HectorMapper()
    for scan, odometry in zip(log.scans[:1500], log.odometry[:1500], strict=True):
        mapper.update(scan, odometry, None)
    errors = relation_errors(mapper.trajectory(), read_relations(folder / "intel.relations.gz"), log.track)
    assert len(errors.translation) > 100
    assert errors.translation.mean() < 0.08
    assert math.degrees(errors.rotation.mean()) < 2.0


@pytest.mark.shared
def test_csail_beginning(shared_data: Path) -> None:
    folder = shared_data / "logs" / "csail"
    log, reference = (
        read_carmen(folder / "mit-csail.clf.gz"),
        read_carmen(folder / "reference_poses.log.gz").track,
    )
    mapper = HectorMapper()
    for scan, odometry in zip(log.scans[:600], log.odometry[:600], strict=True):
        mapper.update(scan, odometry, None)
    estimate = mapper.trajectory()
    near = np.abs(estimate.stamps[:, None] - reference.stamps[None]).argmin(axis=0)
    close = np.abs(estimate.stamps[near] - reference.stamps) < 0.5
    a, b = estimate.xy[near][close], reference.xy[close]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag((1, np.linalg.det(u @ vt))) @ vt
    assert np.sqrt(((a @ turn - b) ** 2).sum(axis=1).mean()) < 0.2


def test_a_laser_scan_is_all_it_needs() -> None:
    scan = LaserScan(np.full(10, 2.0, np.float32), 0.0, 0.1, 0.1, 10.0, 5.0)
    assert make_mapper("hector").update(scan, None, None) == Pose2()
