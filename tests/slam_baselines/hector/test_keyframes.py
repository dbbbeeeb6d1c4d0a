"""Scans hang on keyframes: what moves a keyframe moves them, and nothing else does."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lirs_wct.geometry.pose import Pose2
from slam_baselines.hector.keyframes import KeyframeTrajectory
from slam_baselines.mapping.growing_grid import GrowingGrid

NEAR = st.floats(-3, 3)
POSES = st.builds(Pose2, NEAR, NEAR, NEAR)


@settings(max_examples=50, deadline=None)
@given(st.lists(POSES, min_size=9, max_size=9), st.lists(POSES, min_size=3, max_size=3), st.integers(1, 3))
def test_scans_keep_their_place_beside_their_keyframe(
    scans: list[Pose2], moved: list[Pose2], count: int
) -> None:
    """Three keyframes with three scans each; the first `count` move, then the same once more."""
    poses = KeyframeTrajectory()
    for k, pose in enumerate(scans):
        if k % 3 == 0:
            poses.add_keyframe(pose)
        poses.add(float(k), pose)
    keyframes = scans[::3]
    T_new_old = poses.move(moved[:count])
    np.testing.assert_allclose(
        (T_new_old @ keyframes[count - 1]).as_array()[:2], moved[count - 1].as_array()[:2], atol=1e-9
    )
    late = Pose2(0.3, -0.2, 0.1)
    poses.add(99.0, late)
    now = moved[:count] + keyframes[count:]
    for k, pose in enumerate(scans):
        expected = now[k // 3] @ keyframes[k // 3].inverse() @ pose
        np.testing.assert_allclose(poses.trajectory().xy[k], (expected.x, expected.y), atol=1e-9)
    np.testing.assert_allclose(poses.trajectory().xy[-1], (late.x, late.y), atol=1e-9)
    again = [Pose2(1.0, 2.0, 0.5) @ pose for pose in now]
    poses.move(again)
    expected = again[-1] @ now[-1].inverse() @ late
    np.testing.assert_allclose(poses.trajectory().xy[-1], (expected.x, expected.y), atol=1e-9)


def test_before_the_first_keyframe_poses_are_the_map_s_own() -> None:
    poses = KeyframeTrajectory()
    poses.add(0.0, Pose2(1.0, 2.0, 0.3))
    poses.add_keyframe(Pose2(5.0, 0.0, 0.0))
    poses.move([Pose2(7.0, 0.0, 0.0)])
    assert poses.trajectory().xy.tolist() == [[1.0, 2.0]]


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-40, 40)] * 2, *[st.floats(0, 30)] * 2), min_size=1, max_size=6),
    st.sampled_from((0.05, 0.1, 0.2)),
)
def test_a_grid_holds_every_box_with_a_cell_to_spare(
    boxes: list[tuple[float, float, float, float]], resolution: float
) -> None:
    grid = GrowingGrid(resolution, {"a": (np.uint8, 7)})
    for west, south, width, height in boxes:
        before = grid.layers["a"]
        grew = grid.ensure(west, south, west + width, south + height)
        assert grew == (grid.layers["a"] is not before)
        rows, cols = grid.shape
        assert grid.col0 <= west / resolution - 1 + 1e-6
        assert grid.row0 <= south / resolution - 1 + 1e-6
        assert grid.col0 + cols >= (west + width) / resolution + 2 - 1e-6
        assert grid.row0 + rows >= (south + height) / resolution + 2 - 1e-6
        assert not grid.ensure(west, south, west + width, south + height)
