"""Trajectories: one pose costs the same, however long the trajectory is."""

from __future__ import annotations

import time

import numpy as np

from lirs_wct.geometry.trajectory import Trajectory


def turning(n: int) -> Trajectory:
    half = np.linspace(-1.5, 1.5, n)
    nothing = np.zeros(n)
    quaternions = np.stack((np.cos(half), nothing, nothing, np.sin(half)), axis=-1)
    return Trajectory(
        np.arange(n, dtype=np.float64), np.random.default_rng(0).normal(size=(n, 3)), quaternions
    )


def test_one_pose_is_that_of_the_arrays() -> None:
    track = turning(50)
    for i in (*range(50), -1):
        pose = track.pose2(i)
        assert (pose.x, pose.y, pose.yaw) == (*track.xy[i].tolist(), float(track.yaw[i]))


def test_one_pose_of_a_long_trajectory_costs_no_more_than_of_a_short_one() -> None:
    """All poses one after the other would else cost the square of a log's length."""

    def seconds(track: Trajectory) -> float:
        times = []
        for _ in range(20):
            start = time.perf_counter()
            track.pose2(7)
            times.append(time.perf_counter() - start)
        return min(times)

    assert seconds(turning(500_000)) < 20 * seconds(turning(10))
