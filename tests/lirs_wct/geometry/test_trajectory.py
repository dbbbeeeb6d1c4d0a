"""Trajectories and views: arrays of poses, frames, and cameras that see everything."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory, overview


@given(st.integers(0, 2**32 - 1))
def test_arrays_hold_poses_one_by_one(seed: int) -> None:
    """Tilted poses: the yaw is that about the fixed z axis."""
    rng = np.random.default_rng(seed)
    poses = [Pose3.from_rpy(*row) for row in rng.uniform(-1.4, 1.4, (6, 6)).tolist()]
    track = Trajectory.from_poses(range(10, 16), poses)
    assert len(track) == 6
    assert track.stamps.tolist() == [10, 11, 12, 13, 14, 15]
    np.testing.assert_array_equal(track.positions, [p.position for p in poses])
    np.testing.assert_array_equal(track.quaternions, [p.quaternion for p in poses])
    np.testing.assert_array_equal(track.xy, [p.position[:2] for p in poses])
    np.testing.assert_allclose(track.yaw, [p.yaw for p in poses], atol=1e-12)
    np.testing.assert_allclose(track.pose2(-2).as_array(), poses[4].to_pose2().as_array(), atol=1e-12)


@pytest.mark.parametrize("T", [Pose2(1.2, -3.4, 0.7), Pose3.from_rpy(1, 2, 3, 0.1, -0.2, 2.5)])
@pytest.mark.parametrize("n", [0, 1, 50])
def test_moving_composes_with_every_pose(n: int, T: Pose2 | Pose3) -> None:
    rng = np.random.default_rng(1)
    quaternions = rng.normal(size=(n, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    track = Trajectory(np.arange(n, dtype=np.float64), rng.normal(size=(n, 3)), quaternions)
    in_space = Pose3.from_pose2(T) if isinstance(T, Pose2) else T
    poses = [
        in_space @ Pose3(*p.tolist(), *q.tolist())
        for p, q in zip(track.positions, track.quaternions, strict=True)
    ]
    moved, expected = track.moved(T), Trajectory.from_poses(track.stamps, poses)
    assert np.array_equal(moved.stamps, track.stamps)
    assert np.allclose(moved.positions, expected.positions, rtol=0, atol=1e-14)
    assert np.array_equal(moved.quaternions, expected.quaternions)


def test_length_is_that_of_the_path_in_the_plane() -> None:
    poses = [Pose3(0, 0, 0), Pose3(3, 4, 100), Pose3(3, 4, 0), Pose3(4, 4, 0)]
    assert Trajectory.from_poses([0, 1, 2, 3], poses).length == 6.0
    assert Trajectory.from_poses([0], poses[:1]).length == 0.0


def test_between_two_poses_lies_a_straight_line() -> None:
    track = Trajectory.from_poses(
        [10.0, 12.0, 16.0], [Pose2(1, 2, 3.0), Pose2(2, 0, -3.0), Pose2(2, 8, -2.0)]
    )
    found = track.planar_at(np.array([9.0, 10.0, 10.5, 12.0, 15.0, 17.0]))
    end = math.tau - 3.0  # the short way round, over pi
    np.testing.assert_allclose(found[:, 0], (1, 1, 1.25, 2, 2, 2))
    np.testing.assert_allclose(found[:, 1], (2, 2, 1.5, 0, 6, 8))
    np.testing.assert_allclose(found[:, 2], (3, 3, 3 + (end - 3) / 4, end, end + 0.75, end + 1))


def test_planar_poses_lie_upright_on_the_ground() -> None:
    track = Trajectory.from_poses([0.0, 1.0], [Pose2(1, 2, math.pi / 2), Pose2(3, 4, 0)])
    assert track.positions.tolist() == [[1, 2, 0], [3, 4, 0]]
    half = math.sqrt(0.5)
    np.testing.assert_allclose(track.quaternions, [(half, 0, 0, half), (1, 0, 0, 0)], atol=1e-12)
    nothing = Trajectory.from_poses([], [])
    assert (len(nothing), nothing.positions.shape, nothing.quaternions.shape) == (0, (0, 3), (0, 4))


@pytest.mark.parametrize(
    ("stamps", "positions", "quaternions"),
    [
        ([0.0, 1.0], (1, 3), (2, 4)),
        ([0.0, 1.0], (2, 3), (1, 4)),
        ([0.0, 1.0], (2, 2), (2, 4)),
        ([0.0, 1.0], (2, 3), (2, 3)),
        ([0.0, 0.0], (2, 3), (2, 4)),
        ([0.0, 2.0, 1.0], (3, 3), (3, 4)),
    ],
)
def test_what_is_no_trajectory_is_refused(
    stamps: list[float], positions: tuple[int, int], quaternions: tuple[int, int]
) -> None:
    with pytest.raises(ConfigError, match="a trajectory"):
        Trajectory(np.array(stamps), np.zeros(positions), np.zeros(quaternions))


lengths = st.floats(0.01, 1e4)


@given(st.tuples(lengths, lengths, lengths), st.floats(-100, 100), st.floats(0.2, 1.5), st.floats(0.5, 2.5))
def test_every_corner_is_in_the_picture(
    size: tuple[float, float, float], shift: float, fovy: float, aspect: float
) -> None:
    low = np.array((shift, -2 * shift, 3.0))
    view = overview(low, low + size, fovy, aspect)
    corners = np.array(list(product(*zip(low, low + size, strict=True))))
    ahead, right, up = view.axes @ (corners - view.position).T
    assert (ahead > 0).all()
    half = math.tan(fovy / 2)
    across, high = np.abs(right) / (ahead * half * aspect), np.abs(up) / (ahead * half)
    assert 0.7 < max(across.max(), high.max()) <= 1.0
    np.testing.assert_allclose(np.cross(view.axes[1], view.axes[0]), view.axes[2], atol=1e-12)
