"""Scans move with their keyframes, and only with them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lirs_wct.geometry.pose import Pose2
from slam_baselines.mapping.keyframe import KeyframeTrajectory

NEAR = st.floats(-3, 3)
POSES = st.builds(Pose2, NEAR, NEAR, NEAR)


@settings(max_examples=50, deadline=None)
@given(st.lists(POSES, min_size=9, max_size=9), st.lists(POSES, min_size=3, max_size=3), st.integers(1, 3))
def test_scans_keep_their_place_beside_their_keyframe(
    scans: list[Pose2], moved: list[Pose2], count: int
) -> None:
    """Three keyframes with three scans each; the first `count` move, then the same once more."""
    poses, keyframes = KeyframeTrajectory(), scans[::3]
    for k, pose in enumerate(scans):
        poses.add(float(k), k // 3, keyframes[k // 3].inverse() @ pose)
    late, now = Pose2(0.3, -0.2, 0.1), moved[:count] + keyframes[count:]
    poses.add(99.0, 2, now[2].inverse() @ late)
    found = poses.trajectory(now)
    for k, pose in enumerate(scans):
        expected = now[k // 3] @ keyframes[k // 3].inverse() @ pose
        np.testing.assert_allclose(found.xy[k], (expected.x, expected.y), atol=1e-9)
    np.testing.assert_allclose(found.xy[-1], (late.x, late.y), atol=1e-9)
    again = [Pose2(1.0, 2.0, 0.5) @ pose for pose in now]
    expected = again[-1] @ now[-1].inverse() @ late
    np.testing.assert_allclose(poses.trajectory(again).xy[-1], (expected.x, expected.y), atol=1e-9)


def test_before_the_first_keyframe_poses_are_the_map_s_own() -> None:
    poses = KeyframeTrajectory()
    poses.add(0.0, -1, Pose2(1.0, 2.0, 0.3))
    assert poses.trajectory([Pose2(7.0, 0.0, 0.0)]).xy.tolist() == [[1.0, 2.0]]
    assert poses.trajectory([]).xy.tolist() == [[1.0, 2.0]]


def test_before_the_first_keyframe_poses_follow_it_where_motion_is_measured() -> None:
    poses = KeyframeTrajectory()
    poses.add(0.0, -1, Pose2(1.0, 2.0, 0.3))
    found = poses.trajectory([Pose2(7.0, 0.0, 0.0)], [Pose2(5.0, 0.0, 0.0)])
    np.testing.assert_allclose(found.xy, [[3.0, 2.0]])


def test_scans_between_keyframes_follow_both() -> None:
    track = KeyframeTrajectory()
    for stamp, keyframe, x in ((0.0, 0, 0.0), (0.5, 0, 0.5), (1.0, 1, 0.0), (1.5, 1, 0.5)):
        track.add(stamp, keyframe, Pose2(x, 0))
    poses = track.trajectory([Pose2(0, 0), Pose2(1, 0.4)], [Pose2(0, 0), Pose2(1, 0)])
    np.testing.assert_allclose(poses.xy, [[0, 0], [0.5, 0.2], [1, 0.4], [1.5, 0.4]], atol=1e-9)
