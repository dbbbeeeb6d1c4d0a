"""Cartographer as published: the C++ program's own trajectories, and the whole mapper in a room."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lirs_envs.robots.robot import make_robot
from lirs_extensions.originals.cartographer.local_slam import TrajectoryBuilder
from lirs_extensions.originals.cartographer.mapper import (
    CartographerOriginalConfig,
    CartographerOriginalMapper,
)
from lirs_wct import Pose2
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.geometry import LaserScan, wrap_angles
from slam_baselines.mapper import make_mapper
from tests.lirs_extensions.originals.recorded import unpacked
from tests.slam_baselines.synthetic import drive_room, room_scan

RUNS = ("simple-1", "simple-2", "medium-1", "medium-2", "advanced-2", "willow-1")


def recorded(folder: Path) -> tuple[list[LaserScan], tuple[Pose2, ...]]:
    """Return scans and odometry of a run; the log rounds the mount, which the original knew."""
    log, mount = read_carmen(folder / "scans.clf.gz"), make_robot("husky").T_base_laser
    return [replace(scan, T_base_laser=mount) for scan in log.scans], log.odometry


@pytest.mark.shared
@pytest.mark.parametrize("run", ["advanced-1", *(pytest.param(run, marks=pytest.mark.slow) for run in RUNS)])
def test_local_slam_is_the_original_s(shared_data: Path, tmp_path: Path, run: str) -> None:
    """The file has micrometers; later, float32 rounding puts single points into other voxels."""
    folder = shared_data / "fidelity" / run
    scans, odometry = recorded(folder)
    builder = TrajectoryBuilder(CartographerOriginalConfig())
    poses = [builder.add_scan(*pair)[0] for pair in zip(scans[:25], odometry, strict=False)]
    original = unpacked(folder / "original_cartographer_local.tum.gz", tmp_path)
    np.testing.assert_allclose([(p.x, p.y) for p in poses], original.positions[:25, :2], atol=3e-6)
    np.testing.assert_allclose(
        wrap_angles(np.array([p.yaw for p in poses]) - original.yaw[:25]), 0.0, atol=3e-6
    )


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.parametrize("run", ["simple-2", "advanced-1"])
def test_the_whole_trajectory_is_near_the_original_s(shared_data: Path, tmp_path: Path, run: str) -> None:
    """Without alignment: the first submap is fixed in both."""
    folder = shared_data / "fidelity" / run
    mapper = make_mapper("cartographer_original")
    for scan, odometry in zip(*recorded(folder), strict=True):
        mapper.update(scan, odometry, None)
    ours, original = mapper.trajectory(), unpacked(folder / "original_cartographer.tum.gz", tmp_path)
    apart = np.hypot(*(ours.positions - original.positions)[:, :2].T)
    assert np.sqrt((apart**2).mean()) < 0.04
    assert apart.max() < 0.1


@pytest.mark.slow
def test_loops_are_found_and_tied() -> None:
    """A second lap in a room finds the submap of the first one, and every look gives the same poses."""
    mapper = CartographerOriginalMapper(CartographerOriginalConfig(num_range_data=30, min_score=0.4))
    drive_room(mapper)
    loops, counts = mapper.loops, mapper.stats.counts
    assert 0 < len(loops) == counts["loops"] <= counts["loop_searches"]
    assert all(event.seen < event.stamp and event.score > 0.4 for event in loops[:1])
    assert max(event.distance for event in loops) < 0.3
    first, second = mapper.trajectory(), mapper.trajectory()
    np.testing.assert_array_equal(first.positions, second.positions)


def test_the_online_search_finds_a_large_turn() -> None:
    """A turn of 15 deg that no odometry measured: the scan matcher alone stays at the prediction."""
    rng, still = np.random.default_rng(0), Pose2()
    scans = [room_scan(Pose2(yaw=0.26 * (k > 5)), 0.1 * k, rng) for k in range(8)]
    ends = []
    for switch in (False, True):
        mapper = make_mapper("cartographer_original", use_online_correlative_scan_matching=switch)
        ends.append([mapper.update(scan, still, None).yaw for scan in scans][-1])
    assert abs(ends[1] - 0.26) < 0.01 < 0.1 < abs(ends[0] - 0.26)


def test_a_scan_without_returns_follows_the_odometry() -> None:
    rng = np.random.default_rng(0)
    mapper = CartographerOriginalMapper()
    for k in range(3):
        mapper.update(room_scan(Pose2(), 0.1 * k, rng), Pose2(), None)
    empty = replace(room_scan(Pose2(), 0.3, rng), ranges=np.full(361, np.inf, np.float32))
    assert mapper.update(empty, Pose2(0.2, 0.0), None).x == pytest.approx(0.2, abs=0.02)
    assert mapper.stats.skipped == {"no return": 1}
