"""GMapping as published: the C++ original's own trajectories, seed by seed, and what it must not use."""

import ctypes
import ctypes.util
import math
from pathlib import Path

import numpy as np
import pytest

from lirs_extensions.originals.gmapping.hit_maps import NULL_LIKELIHOOD, HitMaps, match_scan
from lirs_extensions.originals.gmapping.mapper import (
    Drand48,
    GmappingOriginalConfig,
    GmappingOriginalMapper,
    OriginalParticles,
    ProcessedScan,
    path_map,
)
from lirs_wct import Pose2
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.drive_files import write_scans
from lirs_wct.geometry import LaserScan, wrap_angles
from slam_baselines.gmapping.config import GmappingConfig
from slam_baselines.mapper import make_mapper
from tests.lirs_extensions.originals.recorded import unpacked
from tests.slam_baselines.synthetic import loop, room_scan

PARAMETERS = GmappingOriginalConfig().matching


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.parametrize(("run", "seed"), [("advanced-1", 1), ("advanced-2", 3), ("willow-1", 2)])
def test_the_trajectory_is_the_original_s(shared_data: Path, tmp_path: Path, run: str, seed: int) -> None:
    """Same scans, same seed: to the last digit of the original's file, through 40 or more matched scans."""
    folder = shared_data / "fidelity" / run
    log, mapper = read_carmen(folder / "scans.clf.gz"), make_mapper("gmapping_original", seed=seed)
    for scan, odometry in zip(log.scans, log.odometry, strict=True):
        mapper.update(scan, odometry, None)
    original, ours = unpacked(folder / f"original_gmapping_s{seed}.tum.gz", tmp_path), mapper.trajectory()
    np.testing.assert_allclose(ours.positions, original.positions, atol=1e-5)
    np.testing.assert_allclose(wrap_angles(ours.yaw - original.yaw), 0.0, atol=1e-5)
    assert mapper.stats.used >= 40


def test_the_random_numbers_are_the_c_library_s() -> None:
    libc = ctypes.CDLL(ctypes.util.find_library("c"))
    libc.drand48.restype = ctypes.c_double
    for seed in (0, 1, 3, 123456789):
        libc.srand48(ctypes.c_long(seed))
        ours = Drand48(seed)
        assert [ours.random() for _ in range(50)] == [libc.drand48() for _ in range(50)]


def test_a_run_and_its_recorded_log_give_the_same(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(0), loop(25)
    scans = [room_scan(pose, 0.1 * k, rng) for k, pose in enumerate(path)]
    write_scans(tmp_path / "scans.clf.gz", zip(scans, path, strict=True))
    log = read_carmen(tmp_path / "scans.clf.gz")
    online, offline = (GmappingOriginalMapper(GmappingOriginalConfig(seed=2, particles=5)) for _ in range(2))
    for scan, pose, logged, logged_pose in zip(scans, path, log.scans, log.odometry, strict=True):
        online.update(scan, pose, None)
        offline.update(logged, logged_pose, None)
    np.testing.assert_allclose(online.trajectory().positions, offline.trajectory().positions, atol=1e-9)


def test_a_beam_without_return_is_a_hit_at_the_largest_range_below_max_urange() -> None:
    scan = LaserScan(np.array((2.0, np.inf, -np.inf, np.nan), np.float32), 0.0, 0.5, 0.1, 10.0, 0.0)
    taken, left = (GmappingOriginalMapper(GmappingOriginalConfig(maxUrange=most)) for most in (80.0, 9.9))
    for mapper in (taken, left):
        mapper.update(scan, Pose2(), None)
    assert taken.map().occupied.sum() == 2
    assert left.map().occupied.sum() == 1
    assert left.map().free.sum() > 190


def test_a_code_of_a_real_laser_beyond_maxrange_says_nothing(tmp_path: Path) -> None:
    """A SICK reads 81.83 m where nothing came back: the original uses no reading beyond 80 m."""
    beams = " ".join(["2.00"] * 100 + ["81.83"] * 80)
    (tmp_path / "x.clf").write_text(f"FLASER 180 {beams} 0 0 0 0 0 0 1.0 nohost 1.0\n")
    mapper = GmappingOriginalMapper()
    mapper.update(read_carmen(tmp_path / "x.clf").scans[0], Pose2(), None)
    hits = mapper.map().occupied_points()
    assert len(hits) > 50
    assert np.hypot(*hits.T).max() < 2.1
    assert max(mapper.map().shape) < 100


def test_the_climb_finds_a_corner_again() -> None:
    wall = np.linspace(0.0, 2.0, 60)
    ends = np.vstack((np.column_stack((wall, wall * 0 + 2.0)), np.column_stack((wall * 0 + 2.0, wall))))
    maps = HitMaps(1, 0.05)
    maps.register_scan(np.zeros((1, 3)), ends)
    found, _ = match_scan(maps[0], np.array((0.12, -0.08, 0.06)), ends, PARAMETERS)
    np.testing.assert_allclose(found, 0.0, atol=0.01)
    nowhere = np.array((50.0, 50.0, 0.0))
    lost, log_likelihood = match_scan(maps[0], nowhere, ends, PARAMETERS)
    np.testing.assert_array_equal(lost, nowhere)
    assert log_likelihood == pytest.approx(len(ends) * NULL_LIKELIHOOD / PARAMETERS.lsigma)


def test_maps_that_descend_from_one_are_their_own_from_then_on() -> None:
    maps = HitMaps(3, 0.1)
    maps.register_scan(np.zeros((3, 3)), np.array(((1.0, 0.0),)))
    maps.descend(np.array((1, 1, 1)))
    assert maps.in_use == 1
    moved = np.array(((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2), (0.0, 0.0, math.pi)))
    maps.register_scan(moved, np.array(((1.0, 0.0),)))
    for k, (x, y) in enumerate(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0))):
        _, first = match_scan(maps[k], np.zeros(3), np.array(((1.0, 0.0),)), PARAMETERS)
        _, second = match_scan(maps[k], np.zeros(3), np.array(((x, y),)), PARAMETERS)
        assert abs(first) + abs(second) < 1e-12
    _, others = match_scan(maps[0], np.zeros(3), np.array(((-1.0, 0.0),)), PARAMETERS._replace(iterations=1))
    assert others == pytest.approx(NULL_LIKELIHOOD / PARAMETERS.lsigma)


def test_a_cell_of_the_map_is_occupied_above_a_quarter_of_hits() -> None:
    """Two beams through (1, 0), one ends there: a half; of five, one: a fifth."""
    laser = np.zeros(2)
    ends, hits = np.array(((1.0, 0.0), (2.0, 0.0))), np.array((True, True))
    near = ProcessedScan(laser, ends, hits)
    far = ProcessedScan(laser, np.repeat(ends[1:], 3, axis=0), np.ones(3, np.bool_))
    path = np.zeros((1, 3))
    assert path_map(path, [near], 0.5, 0.25).occupied_points()[:, 0].round(3).tolist() == [1.0, 2.0]
    grid = path_map(np.zeros((2, 3)), [near, far], 0.5, 0.25)
    assert grid.occupied_points()[:, 0].round(3).tolist() == [2.0]
    assert grid.free.sum() == 4


def test_srt_and_str_are_the_same_errors_in_both_configs() -> None:
    """A drive of 1 m turns the original's particles by srt, a turn of 1 rad shifts them by str."""
    ours = GmappingConfig(srt=0.3, str=0.1).motion
    config = GmappingOriginalConfig(particles=4000, srr=0.0, srt=0.3, str=0.1, stt=0.0)
    driven, turned = OriginalParticles(config), OriginalParticles(config)
    driven.move(Pose2(1.0, 0.0, 0.0))
    turned.move(Pose2(0.0, 0.0, 1.0))
    assert np.std(driven._poses[:, 2]) == pytest.approx(ours.rotation_per_meter, rel=0.05)
    assert np.std(turned._poses[:, 0]) == pytest.approx(ours.translation_per_radian, rel=0.05)
