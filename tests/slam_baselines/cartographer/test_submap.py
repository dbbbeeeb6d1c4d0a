"""Submaps overlap, and finish when they have seen enough."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.global_slam import Trimmer
from slam_baselines.cartographer.mapper import CartographerMapper
from slam_baselines.cartographer.submap import Submap, Submaps
from slam_baselines.leveling import ScanPoints
from slam_baselines.mapper import make_mapper
from slam_baselines.occupancy_map import bounding_box, union_of
from tests.slam_baselines.large_site import drive_site
from tests.slam_baselines.synthetic import loop, room_scan


def test_submaps_overlap_and_finish():
    submaps = Submaps(CartographerConfig(num_range_data=3))
    scan = ScanPoints(np.zeros(3), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.empty((0, 3)))
    entered = [
        list(submaps.insert_range_data(i, Pose2(i, 0), scan, np.zeros(2, np.uint8), 0)) for i in range(10)
    ]
    assert entered == [[0]] * 3 + [[0, 1]] * 3 + [[1, 2]] * 3 + [[2, 3]]
    assert [s.finished for s in submaps.all] == [True, True, False, False]
    assert submaps.all[1].nodes == [3, 4, 5, 6, 7, 8]
    assert submaps.all[1].pose == Pose2(3, 0)
    assert submaps.matching_submap is submaps.all[2]


def test_few_scans_over_a_long_way_end_a_submap():
    submaps = Submaps(CartographerConfig(num_range_data=60, submap_distance=3.0))
    scan = ScanPoints(np.zeros(3), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.empty((0, 3)))
    for i in range(10):
        submaps.insert_range_data(i, Pose2(i, 0), scan, np.zeros(2, np.uint8), 0)
    assert [s.nodes for s in submaps.all] == [[*range(8)], [4, 5, 6, 7, 8, 9], [8, 9]]
    assert [s.finished for s in submaps.all] == [True, False, False]


def test_room_made_at_once_holds_the_same_as_room_made_scan_by_scan():
    rng, config = np.random.default_rng(4), CartographerConfig()
    away = [np.array((2.0 * k, -1.5 * k, 0.0)) for k in range(6)]
    hits = [rng.uniform((-9, -7, -0.3), (8, 6, 1), (90, 3)) + shift for shift in away]
    scans = [ScanPoints(o, ends, np.empty((0, 3))) for o, ends in zip(away, hits, strict=True)]
    slopes = rng.integers(0, 256, (6, 90)).astype(np.uint8)
    growing, reserved = Submaps(config), Submaps(config).empty_copy(config)
    reserved.reserve(Pose2(), union_of([bounding_box(scan) for scan in scans]))
    frames = [reserved.all[0].levels.frames.copy()]
    for k, scan in enumerate(scans):
        for submaps in (growing, reserved):
            assert list(submaps.insert_range_data(k, Pose2(0.1 * k, 0), scan, slopes[k], 60)) == [0]
        frames.append(growing.all[0].levels.frames.copy())
    assert not np.array_equal(frames[1], frames[-1])
    np.testing.assert_array_equal(frames[0], frames[-1])
    for grown, roomy in zip(growing.all[0].pyramid.maps, reserved.all[0].pyramid.maps, strict=True):
        for before, after in zip(grown.layers, roomy.layers, strict=True):
            np.testing.assert_array_equal(before, after)


def drawn(config: CartographerConfig | None = None, seed: int = 0) -> Submap:
    """A submap of ten scans, some of whose hits are steep."""
    rng, submap = np.random.default_rng(seed), Submap(config or CartographerConfig(), Pose2(1, 2, 0.3))
    for k in range(10):
        hits = np.column_stack((rng.uniform(-9, 7, 60), rng.uniform(-3, 5, 60), rng.uniform(0, 1, 60)))
        free = np.column_stack((rng.uniform(-9, 7, 9), rng.uniform(-3, 5, 9), rng.uniform(0, 1, 9)))
        slopes = rng.integers(0, 200, 60).astype(np.uint8)
        submap.draw_range_data(k, ScanPoints(np.zeros(3), hits, free), slopes, 0)
    return submap


def looked_up(submap: Submap, level: int) -> dict[tuple[int, int], int]:
    """Lattice row and column -> value, of the cells that say something."""
    value, frame = submap.levels.values[level], submap.levels.frames[level]
    rows, cols = np.nonzero(value)
    keys = zip((rows + int(frame[0])).tolist(), (cols + int(frame[1])).tolist(), strict=True)
    return dict(zip(keys, value[rows, cols].tolist(), strict=True))


@pytest.mark.parametrize("wall_slope", [0, 80])
def test_a_finished_submap_is_seen_as_before(wall_slope: int) -> None:
    submap, before = drawn(), drawn()
    submap.finish()
    for each in (submap, before):
        each.set_wall_slope(wall_slope)
    for level in range(3):
        assert looked_up(submap, level) == looked_up(before, level)
        assert len(looked_up(submap, level)) > 300
        np.testing.assert_array_equal(submap.levels.frames[:, 2], before.levels.frames[:, 2])
    key = np.lexsort(submap.known_points.T), np.lexsort(before.known_points.T)
    np.testing.assert_array_equal(submap.known_points[key[0]], before.known_points[key[1]])


def test_a_margin_lets_the_matcher_interpolate_at_the_border() -> None:
    submap = drawn()
    submap.finish()
    for value in submap.levels.values:
        assert not value[[0, -1]].any()
        assert not value[:, [0, -1]].any()
        assert value.flags.c_contiguous
        assert value.flags.writeable


def test_what_was_searched_in_longest_ago_is_released() -> None:
    one = drawn()
    one.finish()
    packed = one.nbytes
    _ = one.bounds
    unpacked = one.unpacked_nbytes
    assert packed < unpacked / 4
    config = CartographerConfig(max_unpacked_bytes=2 * unpacked + unpacked // 2)
    submaps = Submaps(config)
    submaps.all = [drawn(config) for _ in range(4)]
    for index, submap in enumerate(submaps.all):
        submap.finish()
        _ = submap.bounds
        submaps.note_search(index)
    assert [submap.unpacked_nbytes > 0 for submap in submaps.all] == [False, False, True, True]
    _ = submaps.all[2].bounds
    submaps.note_search(2)
    _ = submaps.all[0].bounds
    submaps.note_search(0)
    assert [submap.unpacked_nbytes > 0 for submap in submaps.all] == [True, False, True, False]


def test_large_submaps_are_searched_on_a_coarser_level() -> None:
    assert drawn().bounds.resolution == pytest.approx(0.1)
    assert drawn(CartographerConfig(max_search_cells=100)).bounds.resolution == pytest.approx(0.2)


LAP = 100


def submap_at(x: float, size: float = 4.0) -> Submap:
    """A submap with walls around a square of floor at (x, 0)."""
    submap = Submap(CartographerConfig(), Pose2(x, 0, 0.3))
    angle = np.linspace(0, 2 * np.pi, 2000)
    reach = size / 2 / np.maximum(abs(np.cos(angle)), abs(np.sin(angle)))
    hits = np.stack((x + reach * np.cos(angle), reach * np.sin(angle), 0 * angle), axis=-1)
    submap.draw_range_data(
        0, ScanPoints(np.array((x, 0.0, 0.0)), hits, np.empty((0, 3))), np.zeros(2000, np.uint8), 0
    )
    return submap


def trimmer_of(xs: list[float], **config: int) -> tuple[Trimmer, list[Pose2]]:
    trimmer, poses = Trimmer(CartographerConfig(**config)), []
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


@pytest.fixture(scope="module")
def ten_laps() -> tuple[CartographerMapper, list[Pose2], list[int]]:
    """A room driven round ten times, in small submaps; the mapper, the truth, memory after each lap."""
    config = CartographerConfig(num_range_data=15, min_added_submaps_count=2, optimize_every_n_nodes=10)
    mapper, rng, memory = CartographerMapper(config), np.random.default_rng(1), []
    truth = [pose for _ in range(10) for pose in loop(LAP + 1)[:LAP]]
    for i, pose in enumerate(truth):
        odometry = Pose2(2, 1, 1) @ truth[0].inverse() @ pose
        mapper.update(room_scan(pose, 0.2 * i, rng), odometry, None)
        if i % LAP == LAP - 1:
            memory.append(mapper.stats.memory)
    return mapper, truth, memory


def test_memory_does_not_grow_with_time(ten_laps: tuple[CartographerMapper, list[Pose2], list[int]]) -> None:
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


@pytest.mark.slow
def test_a_large_site_fits_into_600_megabytes():
    drive, mapper, most = drive_site(scans=1000, step=1.75), make_mapper("cartographer"), 0
    for k, (scan, odometry) in enumerate(zip(drive.scans, drive.odometry, strict=True)):
        pose = mapper.update(scan, odometry, None)
        if k % 20 == 0 or k == len(drive.scans) - 1:
            most = max(most, mapper.stats.memory)
    assert mapper.stats.counts["submaps"] > 60
    assert mapper.stats.counts["loops"] > 50
    assert mapper.stats.counts["submaps_trimmed"] < 10, "what was forgotten needs no memory"
    assert pose.distance(drive.truth[0].inverse() @ drive.truth[-1]) < 3.0
    assert 50e6 < most < 600e6
