"""The schedule of the start-up refinement, and the trajectory of all scans."""

import numpy as np
from hypothesis import given, settings, strategies as st

from lirs_wct.geometry.pose import Pose2
from slam_baselines.front_end import FrontEndConfig, Keyframe, KeyframeTrajectory, StartUp
from slam_baselines.leveling import LeveledScan

NOTHING = np.empty((0, 3))
SCAN = LeveledScan(np.zeros(3), NOTHING, NOTHING, (0.0, 0.0), True, 0.0)


def refined_at(first: float, last: float, ready: float) -> list[float]:
    """Distances of the refinements of a drive over 30 m, each done when it is due and `ready` is reached."""
    start = StartUp[Keyframe](FrontEndConfig(bootstrap_first=first, bootstrap_last=last))
    found = []
    for k in range(61):
        keyframe = Keyframe(SCAN, Pose2(0.5 * k), 0.0, np.empty(0, np.uint8))
        if start.add(keyframe, 0.5 * k) and 0.5 * k >= ready:
            start.replace(start.keyframes)
            found.append(0.5 * k)
    assert start.refinements == len(found)
    return found


def test_refinements_come_at_twice_the_distance() -> None:
    assert refined_at(2.0, 40.0, ready=0.0) == [2.0, 4.0, 8.0, 16.0]
    assert refined_at(2.0, 10.0, ready=0.0) == [2.0, 4.0, 8.0]


def test_a_late_refinement_is_not_repeated_at_once() -> None:
    assert refined_at(2.0, 40.0, ready=6.5) == [6.5, 8.0, 16.0]


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
