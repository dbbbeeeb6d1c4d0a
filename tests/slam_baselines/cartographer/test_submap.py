"""Submaps overlap, and finish when they have seen enough."""

from __future__ import annotations

import numpy as np

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import SubmapConfig
from slam_baselines.cartographer.submap import Submaps
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
    growing, reserved = Submaps(config), Submaps(config).restarted(config)
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
