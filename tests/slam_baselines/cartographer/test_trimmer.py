"""Memory goes with the area: submaps of places seen often enough are forgotten, every scan's pose is not."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import (
    CartographerConfig,
    GlobalConfig,
    LocalConfig,
    SubmapConfig,
    TrimmingConfig,
)
from slam_baselines.cartographer.mapper import CartographerMapper
from slam_baselines.cartographer.submap import Submap
from slam_baselines.cartographer.trimmer import Trimmer
from slam_baselines.scan.leveling import ScanPoints
from tests.slam_baselines.synthetic import loop, room_scan

LAP = 100


def submap_at(x: float, size: float = 4.0) -> Submap:
    """A submap with walls around a square of floor at (x, 0)."""
    submap = Submap(SubmapConfig(), Pose2(x, 0, 0.3))
    angle = np.linspace(0, 2 * np.pi, 2000)
    reach = size / 2 / np.maximum(abs(np.cos(angle)), abs(np.sin(angle)))
    hits = np.stack((x + reach * np.cos(angle), reach * np.sin(angle), 0 * angle), axis=-1)
    submap.draw_range_data(
        0, ScanPoints(np.array((x, 0.0, 0.0)), hits, np.empty((0, 3))), np.zeros(2000, np.uint8), 0
    )
    return submap


def trimmer_of(xs: list[float], **config: int) -> tuple[Trimmer, list[Pose2]]:
    trimmer, poses = Trimmer(TrimmingConfig(**config)), []
    for i, x in enumerate(xs):
        submap = submap_at(x)
        trimmer.add_finished_submap(i, submap)
        poses.append(submap.pose)
    return trimmer, poses


def test_of_each_place_the_freshest_are_kept() -> None:
    trimmer, poses = trimmer_of([0, 10, 0, 10, 0, 20], fresh_submaps_count=2)
    assert trimmer.trimming_due()
    assert trimmer.pop_redundant(poses) == [0]
    assert not trimmer.trimming_due()
    assert trimmer.pop_redundant(poses) == []


def test_where_they_lie_now_counts_and_not_where_they_were_drawn() -> None:
    trimmer, poses = trimmer_of([0, 10, 20], fresh_submaps_count=1)
    assert trimmer.pop_redundant(poses) == []
    # A loop has moved all of them to one place.
    trimmer, _ = trimmer_of([0, 10, 20], fresh_submaps_count=1)
    assert trimmer.pop_redundant([Pose2(5, 5, 1)] * 3) == [1, 0]


def test_a_submap_that_shows_something_of_its_own_is_kept() -> None:
    trimmer, poses = trimmer_of([2.0, 0.0], fresh_submaps_count=1)
    assert trimmer.pop_redundant(poses) == []
    trimmer, poses = trimmer_of([0.5, 0.0], fresh_submaps_count=1)
    assert trimmer.pop_redundant(poses) == [0]


def test_a_trimmed_submap_holds_nothing() -> None:
    submap = submap_at(0.0)
    assert submap.nbytes > 10000
    assert len(submap.known_points) > 300
    assert abs(submap.known_points).max() < 2.4
    submap.drop_grids()
    assert submap.nbytes == 0
    assert len(submap.known_points) == 0
    assert submap.pose == Pose2(0, 0, 0.3)


@pytest.fixture(scope="module")
def ten_laps() -> tuple[CartographerMapper, list[Pose2], list[int]]:
    """A room driven round ten times, in small submaps; the mapper, the truth, memory after each lap."""
    config = CartographerConfig(
        local=LocalConfig(submaps=SubmapConfig(num_range_data=15)),
        graph=GlobalConfig(trimming=TrimmingConfig(min_added_submaps_count=2), optimize_every_n_nodes=10),
    )
    mapper, rng, memory = CartographerMapper(config), np.random.default_rng(1), []
    truth = [pose for _ in range(10) for pose in loop(LAP + 1)[:LAP]]
    for i, pose in enumerate(truth):
        odometry = Pose2(2, 1, 1) @ truth[0].inverse() @ pose
        mapper.update(room_scan(pose, 0.2 * i, rng), odometry, None)
        if i % LAP == LAP - 1:
            memory.append(mapper.stats.memory)
    return mapper, truth, memory


def test_memory_does_not_grow_with_time(
    ten_laps: tuple[CartographerMapper, list[Pose2], list[int]],
) -> None:
    mapper, _, memory = ten_laps
    counts = mapper.stats.counts
    assert counts["submaps"] > 20
    assert counts["submaps_trimmed"] > counts["submaps"] / 2
    assert memory[1] > 1.1 * memory[0]
    assert max(memory[5:]) < 1.2 * max(memory[:5])


def test_every_scan_still_has_a_place(ten_laps: tuple[CartographerMapper, list[Pose2], list[int]]) -> None:
    mapper, truth, _ = ten_laps
    path = mapper.trajectory()
    assert len(path) == len(truth)
    off = [path.pose2(i).distance(truth[0].inverse() @ p) for i, p in enumerate(truth)]
    assert max(off) < 0.05
    grid = mapper.map()
    assert grid.occupied.sum() > 400


def test_loops_are_reported(ten_laps: tuple[CartographerMapper, list[Pose2], list[int]]) -> None:
    mapper, truth, _ = ten_laps
    events = mapper.loops
    assert len(events) == mapper.stats.counts["loops"] > 5
    for event in events:
        assert 0 <= event.seen < 0.2 * len(truth)
        assert event.score > 0.4
        true = truth[0].inverse() @ truth[round(event.stamp / 0.2)]
        assert event.after.distance(true) < 0.1
        assert event.distance == event.before.distance(event.after)
    with pytest.raises(FrozenInstanceError):
        events[0].score = 1.0  # type: ignore[misc]


def test_illegal_trimming_is_named() -> None:
    with pytest.raises(ConfigError, match="fresh_submaps_count"):
        TrimmingConfig(fresh_submaps_count=0)
