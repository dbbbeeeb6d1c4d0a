"""Submaps overlap, and finish when they have seen enough."""

from __future__ import annotations

import numpy as np

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import SubmapConfig
from slam_baselines.cartographer.submap import Submaps
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
