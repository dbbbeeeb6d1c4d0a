"""Pairs of poses by path and by time, by hand; errors of their motion against `Pose2`."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_validation.metrics.trajectory import (
    motion_errors,
    pairs_by_path,
    pairs_by_time,
    relative_pose_error,
)
from lirs_wct.geometry.pose import Pose2


def pairs(found: tuple[np.ndarray, np.ndarray]) -> list[tuple[int, int]]:
    return list(zip(*(k.tolist() for k in found), strict=True))


def test_pairs_are_a_stretch_of_path_apart_or_just_above() -> None:
    # Steps of 0.5, 0.5, 0.25, 1.0, 0.25, 0.25, 0.25, 0.25, 0.5 along both axes; only the path counts.
    steps = np.array([(0.5, 0), (0, 0.5), (0, -0.25), (0.6, 0.8), *[(-0.25, 0)] * 4, (0, 0.5)])
    poses = np.column_stack((np.cumsum([(7.0, -3.0), *steps], axis=0), np.zeros(10)))
    assert pairs(pairs_by_path(poses, 1.0)) == [(0, 2), (2, 4), (4, 8)]
    assert pairs(pairs_by_path(poses, 1.5)) == [(0, 4), (4, 9)]
    assert pairs(pairs_by_path(poses, 9.0)) == []
    assert pairs(pairs_by_path(poses[:1], 1.0)) == []


def test_pairs_are_a_time_apart_to_the_nearest_stamp() -> None:
    even = np.arange(9) * 0.25 + 100
    assert pairs(pairs_by_time(even, 1.0)) == [(k, k + 4) for k in range(5)]
    assert pairs(pairs_by_time(even, 1.1)) == [(k, k + 4) for k in range(5)]
    assert pairs(pairs_by_time(even, 0.9)) == [(k, k + 4) for k in range(5)]
    assert pairs(pairs_by_time(even, 2.0)) == [(0, 8)]
    assert pairs(pairs_by_time(even, 2.25)) == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a single stamp has no step
        assert pairs(pairs_by_time(np.array([5.0]), 1.0)) == []
    # A pose alone in a gap has no partner within the usual step.
    gaps = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 4.0, 4.25])
    assert pairs(pairs_by_time(gaps, 1.0)) == [(0, 4), (1, 5), (2, 5)]


@given(st.integers(0, 2**32 - 1))
def test_errors_against_poses_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true, found = (np.column_stack((rng.uniform(-9, 9, (6, 2)), rng.uniform(-4, 4, 6))) for _ in range(2))
    i, j = np.array([0, 1, 1, 4]), np.array([2, 1, 5, 3])
    expected = []
    for a, b in zip(i.tolist(), j.tolist(), strict=True):
        q = Pose2(*true[a].tolist()).inverse() @ Pose2(*true[b].tolist())
        p = Pose2(*found[a].tolist()).inverse() @ Pose2(*found[b].tolist())
        expected.append(q.inverse() @ p)
    shift, turn = motion_errors(true, found, (i, j))
    np.testing.assert_allclose(shift, [math.hypot(e.x, e.y) for e in expected], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * turn), [np.exp(1j * e.yaw) for e in expected], atol=1e-9)
    assert (np.abs(turn) <= math.pi + 1e-12).all()
    whole = relative_pose_error(true, found, (i, j))
    assert whole.translation_rmse == pytest.approx(math.sqrt(np.mean([e.x**2 + e.y**2 for e in expected])))
    assert whole.rotation_rmse == pytest.approx(math.sqrt(np.mean([e.yaw**2 for e in expected])))
    assert whole.pairs == 4


def test_no_pair_is_none_and_one_is_enough() -> None:
    poses = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    nothing = np.empty(0, np.int64)
    assert relative_pose_error(poses, poses, (nothing, nothing)) is None
    one = relative_pose_error(poses, 2 * poses, (np.array([0]), np.array([1])))
    assert (one.translation_rmse, one.rotation_rmse, one.pairs) == (1.0, 0.0, 1)
