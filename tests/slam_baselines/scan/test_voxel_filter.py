"""The voxel filter keeps one point a square, and at most so many."""

from __future__ import annotations

import numpy as np

from slam_baselines.scan.voxel_filter import voxel_filter


def test_the_voxel_filter_keeps_one_point_a_square() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (500, 3))
    thin = voxel_filter(points, 0.5, 1000)
    cells = {tuple(c) for c in np.floor(thin[:, :2] / 0.5).astype(int).tolist()}
    assert len(thin) == len(cells) == 16
    assert len(voxel_filter(points, 0.05, 40)) <= 40
