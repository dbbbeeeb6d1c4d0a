"""Scans between nodes."""

from __future__ import annotations

import numpy as np

from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.node_trajectory import NodeTrajectory


def test_scans_between_nodes_follow_both():
    track = NodeTrajectory()
    local = [Pose2(0, 0), Pose2(1, 0)]
    for stamp, x in ((0.0, 0.0), (0.5, 0.5)):
        track.add(stamp, Pose2(x, 0), 1, local[0])
    track.add(1.0, Pose2(1, 0), 2, local[1])
    track.add(1.5, Pose2(1.5, 0), 2, local[1])
    poses = track.trajectory(local, [Pose2(0, 0), Pose2(1, 0.4)], Pose2())
    np.testing.assert_allclose(poses.xy, [[0, 0], [0.5, 0.2], [1, 0.4], [1.5, 0.4]], atol=1e-9)
