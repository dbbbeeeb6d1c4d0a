"""Submaps overlap, and finish when they have seen enough."""

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import SubmapConfig
from slam_baselines.cartographer.submap import Submap, Submaps
from slam_baselines.mapping.occupancy_map import bounding_box, union_of
from slam_baselines.scan.leveling import ScanPoints


def test_submaps_overlap_and_finish():
    submaps = Submaps(SubmapConfig(num_range_data=3))
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
    submaps = Submaps(SubmapConfig(num_range_data=60, max_distance=3.0))
    scan = ScanPoints(np.zeros(3), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.empty((0, 3)))
    for i in range(10):
        submaps.insert_range_data(i, Pose2(i, 0), scan, np.zeros(2, np.uint8), 0)
    assert [s.nodes for s in submaps.all] == [[*range(8)], [4, 5, 6, 7, 8, 9], [8, 9]]
    assert [s.finished for s in submaps.all] == [True, False, False]


def test_room_made_at_once_holds_the_same_as_room_made_scan_by_scan():
    rng, config = np.random.default_rng(4), SubmapConfig()
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


def drawn(config: SubmapConfig | None = None, seed: int = 0) -> Submap:
    """A submap of ten scans, some of whose hits are steep."""
    rng, submap = np.random.default_rng(seed), Submap(config or SubmapConfig(), Pose2(1, 2, 0.3))
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


def test_the_slope_of_walls_may_change_after_the_end() -> None:
    submap = drawn()
    submap.finish()
    flat = looked_up(submap, 0)
    submap.set_wall_slope(80)
    assert len(looked_up(submap, 0)) < len(flat)
    submap.set_wall_slope(0)
    assert looked_up(submap, 0) == flat


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
    config = SubmapConfig(max_unpacked_bytes=2 * unpacked + unpacked // 2)
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
    assert drawn(SubmapConfig(max_search_cells=100)).bounds.resolution == pytest.approx(0.2)
