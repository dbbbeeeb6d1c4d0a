"""The schedule of the start-up refinement, and the trajectory of all scans."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_wct.geometry import FloatArray, Pose2
from slam_baselines.dead_reckoning import DriftCovariance
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


WALLS = np.column_stack((10 * np.cos(np.arange(0.0, 6.2, 0.1)), 10 * np.sin(np.arange(0.0, 6.2, 0.1))))
"""Hits of a round room of 10 m around the robot."""
STEP = np.diag((1e-4, 1e-4, 1e-6))
"""Covariance of a step of 10 cm."""


def drive(steps: int, *, matched: FloatArray | None = None, back: bool = False) -> list[FloatArray]:
    """Covariances of a drive ahead, and back again, with a keyframe each step."""
    drift, pose, found = DriftCovariance(0.01), Pose2(), []
    drift.add_keyframe(pose, WALLS)
    for k in range(2 * steps if back else steps):
        ahead = 0.1 if k < steps else -0.1
        before, pose = pose, Pose2(pose.x + ahead)
        drift.move(before, pose, STEP, 0.1)
        if matched is not None:
            prior = found[-1] + STEP if found else STEP
            drift.match(pose, prior, np.minimum(prior, matched), WALLS)
        drift.add_keyframe(pose, WALLS)
        found.append(drift.covariance)
    return found


def test_the_covariance_grows_under_dead_reckoning() -> None:
    """Against the sum over independent steps: x by steps, y by the lever of the yaw too."""
    found = drive(100)[-1]
    bias = math.radians(0.02) * 10.0
    assert found[0, 0] == pytest.approx(100 * 1e-4)
    assert found[2, 2] == pytest.approx(100 * 1e-6 + bias**2)
    assert found[1, 1] > 100 * 1e-4 + 1e-6 * sum((0.1 * k) ** 2 for k in range(100))


@pytest.mark.parametrize("matched", [None, np.diag((1e-6, 1e-6, 1e-8)), np.diag((1e-6, 1.0, 1.0))])
def test_a_covariance_is_symmetric_and_positive_semidefinite(matched: FloatArray | None) -> None:
    for covariance in drive(200, matched=matched, back=True):
        np.testing.assert_allclose(covariance, covariance.T, rtol=0, atol=1e-15)
        assert np.linalg.eigvalsh(covariance)[0] >= -1e-15


def test_matches_hold_the_error_of_the_map_in_view() -> None:
    """A wall's place within reach of the start; more at the frontier; little again on the way back."""
    exact = np.diag((1e-8, 1e-8, 1e-10))
    found = np.array(drive(400, matched=exact, back=True))[:, 0, 0]
    assert found[40] == pytest.approx(0.01**2, rel=0.01)
    assert found[399] > 3 * found[40]
    assert found[-1] == pytest.approx(0.01**2, rel=0.01)


def test_a_match_leaves_the_direction_that_it_does_not_see() -> None:
    """In a corridor along x, only y and yaw are held."""
    drift = DriftCovariance(0.01)
    drift.add_keyframe(Pose2(), WALLS)
    for k in range(1, 41):
        drift.move(Pose2(0.1 * (k - 1)), Pose2(0.1 * k), STEP, 0.1)
        drift.match(Pose2(0.1 * k), 2 * STEP, np.diag((2e-4, 1e-8, 1e-10)), WALLS)
    assert drift.covariance[0, 0] == pytest.approx(40 * 1e-4, rel=0.05)
    assert drift.covariance[1, 1] == pytest.approx(0.01**2, rel=0.05)


def test_turns_on_a_slope_slide_in_one_direction() -> None:
    """The robot turns on the spot: the slide grows with the turn, not with its root, downhill alone."""
    drift, turns = DriftCovariance(0.01), 100
    for k in range(turns):
        before, pose = Pose2(0.0, 0.0, 0.1 * k), Pose2(0.0, 0.0, 0.1 * (k + 1))
        slope = 0.2 * math.cos(pose.yaw), -0.2 * math.sin(pose.yaw)  # uphill is the map's x
        drift.move(before, pose, np.zeros((3, 3)), 0.0, slope)
    slid = 0.2 * 0.1 * turns
    np.testing.assert_allclose(drift.covariance, np.diag((slid**2, 0.0, 0.0)), atol=1e-12)
