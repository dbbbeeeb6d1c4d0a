"""A scan is found in a submap, from near and from far."""

from __future__ import annotations

import math

import numpy as np

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import SubmapConfig
from slam_baselines.cartographer.loop_closure.constraint_builder import ConstraintBuilder
from slam_baselines.cartographer.loop_closure_config import ConstraintConfig
from slam_baselines.cartographer.submap import Submap
from slam_baselines.scan.leveling import ScanPoints
from tests.slam_baselines.cartographer.corridor import corridor_scan


def test_a_scan_is_found_in_a_submap():
    rng = np.random.default_rng(0)
    submap = Submap(SubmapConfig(), Pose2())
    pose = Pose2(7.5, 0.0, math.pi / 2)
    scan = corridor_scan(pose, 0.0, rng)
    hits = ends(scan)
    for _ in range(4):
        placed = ScanPoints(np.zeros(3), lifted(pose.apply(hits)), np.empty((0, 3)))
        submap.draw_range_data(0, placed, np.zeros(len(hits), np.uint8), 0)
    builder = ConstraintBuilder(ConstraintConfig())
    for distance_traveled, shift in ((0.0, Pose2(0.1, -0.1, 0.02)), (100.0, Pose2(0.9, 0.6, -0.2))):
        found = builder.compute_constraint(submap, lifted(hits), pose @ shift, distance_traveled)
        assert found is not None
        assert found.pose.distance(pose) < 0.05
        assert found.score > 0.4
    assert builder.compute_constraint(submap, lifted(hits[:5]), pose, 0.0) is None
    assert builder.compute_constraint(submap, lifted(rng.uniform(-5, 5, (150, 2))), pose, 100.0) is None
    assert builder.counts.found == 2


def ends(scan):
    r, a = scan.ranges[scan.hits], scan.angles[scan.hits]
    return np.stack((r * np.cos(a), r * np.sin(a)), axis=-1)


def lifted(points):
    return np.column_stack((points, np.zeros(len(points))))
