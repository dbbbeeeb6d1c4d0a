"""The relation metric against cases computed by hand."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_validation.logs.read_log import read_constraints
from lirs_validation.metrics.trajectory import (
    RelativePoseConstraint,
    close_pairs,
    constraint_error_summary,
    constraint_errors,
    poses_at,
)
from lirs_wct.errors import SourceError
from lirs_wct.geometry.pose import Pose2, Trajectory
from tests.kit import refused

STAMPS = [0.0, 1.0, 2.0]


@given(seed=st.integers(0, 2**32 - 1))
def test_all_at_once_is_one_after_the_other(seed: int) -> None:
    """The array code against the metric written down pose by pose."""
    rng = np.random.default_rng(seed)

    def walk(n: int) -> Trajectory:
        stamps = np.cumsum(rng.uniform(0.05, 1.5, n)).tolist()
        return Trajectory.from_poses(stamps, [Pose2(*row) for row in rng.normal(size=(n, 3)).tolist()])

    estimate, odometry = walk(12), walk(20)
    relations = tuple(
        RelativePoseConstraint(*rng.uniform(-3, 15, 2).tolist(), Pose2(*rng.normal(size=3).tolist()))
        for _ in range(15)
    )
    errors = constraint_errors(estimate, relations, odometry)
    low, high = estimate.stamps[0] - 2, estimate.stamps[-1] + 2
    inside = [r for r in relations if all(low <= t <= high for t in (r.stamp_a, r.stamp_b))]
    expected = [
        r.T_ab.inverse()
        @ carried(estimate, odometry, r.stamp_a).inverse()
        @ carried(estimate, odometry, r.stamp_b)
        for r in inside
    ]
    np.testing.assert_allclose(errors.translation, [math.hypot(e.x, e.y) for e in expected], atol=1e-9)
    np.testing.assert_allclose(np.cos(errors.rotation), [math.cos(e.yaw) for e in expected], atol=1e-9)
    assert errors.outside == len(relations) - len(inside)


def carried(estimate: Trajectory, odometry: Trajectory, stamp: float) -> Pose2:
    i = int(np.argmin(np.abs(estimate.stamps - stamp)))
    if abs(estimate.stamps[i] - stamp) <= 0.1:
        return estimate.pose2(i)
    return estimate.pose2(i) @ at(odometry, estimate.stamps[i]).inverse() @ at(odometry, stamp)


def at(track: Trajectory, stamp: float) -> Pose2:
    """Linear between the neighbors, the end beyond the ends."""
    stamp = float(np.clip(stamp, track.stamps[0], track.stamps[-1]))
    j = int(np.clip(np.searchsorted(track.stamps, stamp), 1, len(track) - 1))
    a, b = track.pose2(j - 1), track.pose2(j)
    t = (stamp - track.stamps[j - 1]) / (track.stamps[j] - track.stamps[j - 1])
    yaw = a.yaw + t * math.remainder(b.yaw - a.yaw, math.tau)
    return Pose2(a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), yaw)


@pytest.mark.parametrize(
    ("stamp", "propagated"), [(1.0, False), (1.125, True), (0.875, True), (1.0625, False), (1.5, True)]
)
def test_a_pose_a_tenth_of_a_second_away_is_propagated(stamp: float, propagated: bool) -> None:
    estimate = Trajectory.from_poses([1.0, 2.0], [Pose2(5.0, 5.0, 0.0), Pose2(8.0, 8.0, 0.0)])
    odometry = Trajectory.from_poses([0.0, 4.0], [Pose2(), Pose2(4.0)])
    expected = (5.0 + (stamp - 1.0) * propagated, 5.0, 0.0)  # of two as near, the earlier
    np.testing.assert_allclose(poses_at(estimate, np.array([stamp]), odometry)[0], expected, atol=1e-12)


@pytest.mark.parametrize("stamp", [1.1, 0.9])
def test_just_a_tenth_of_a_second_is_near(stamp: float) -> None:
    estimate = Trajectory.from_poses([0.0], [Pose2(5.0)])
    odometry = Trajectory.from_poses([-4.0, 4.0], [Pose2(-4.0), Pose2(4.0)])
    assert poses_at(estimate, np.array([stamp - 1.0 - 1e-9 * (stamp - 1.0)]), odometry)[0, 0] == 5.0


@pytest.mark.parametrize(("stamp", "used"), [(-2.0, 1), (-2.01, 0), (4.0, 1), (4.01, 0)])
def test_two_seconds_outside_are_still_compared(stamp: float, used: int) -> None:
    estimate = Trajectory.from_poses(STAMPS, [Pose2(float(t), 0.0, 0.0) for t in STAMPS])
    for pair in ((stamp, 1.0), (1.0, stamp)):
        errors = constraint_errors(estimate, (RelativePoseConstraint(*pair, Pose2()),), estimate)
        assert (len(errors.translation), errors.outside) == (used, 1 - used)
        assert errors.stamps.tolist() == [min(pair)] * used


def test_without_odometry_the_estimate_itself_propagates() -> None:
    estimate = Trajectory.from_poses(STAMPS, [Pose2(2.0 * t, 0.0, 0.0) for t in STAMPS])
    constraint = RelativePoseConstraint(0.25, 1.25, Pose2(2.0))
    for odometry in (Trajectory.from_poses([], []), Trajectory.from_poses([0.5], [Pose2()])):
        errors = constraint_errors(estimate, (constraint,), odometry)
        # A single pose of odometry says that the robot stood still.
        assert errors.translation[0] == pytest.approx(0.0, abs=1e-12)
    none = constraint_errors(estimate, (), estimate)
    assert (len(none.translation), len(none.rotation), none.outside) == (0, 0, 0)


def test_relations_are_read_number_by_number(tmp_path: Path) -> None:
    text = b"# stamps x y z roll pitch yaw\n\n10.5 20.25 1 -2 3 0.1 0.2 -0.3\n1 2 4 5 6 7 8 0.5\n"
    expected = (
        RelativePoseConstraint(10.5, 20.25, Pose2(1.0, -2.0, -0.3)),
        RelativePoseConstraint(1.0, 2.0, Pose2(4.0, 5.0, 0.5)),
    )
    for content in (text, gzip.compress(text)):
        (tmp_path / "r.relations").write_bytes(content)
        assert read_constraints(tmp_path / "r.relations") == expected


def test_close_pairs_by_hand() -> None:
    # Marks a meter of path apart at 0, 1, 2, 3 m east, then back on a line 1.5 m north.
    x = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.0, 3.0, 2.0, 1.0]
    y = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 1.5, 1.5, 1.5]
    poses = np.column_stack((np.add(x, 100.0), np.subtract(y, 50.0), np.zeros(11)))
    i, j = close_pairs(poses)
    marks = [0, 2, 4, 6, 8, 9, 10]
    expected = [
        (a, b)
        for k, a in enumerate(marks)
        for b in marks[k + 1 :]
        if math.hypot(x[a] - x[b], y[a] - y[b]) <= 2.0
    ]
    assert (0, 4) in expected
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == expected
    assert [len(k) for k in close_pairs(poses[:2])] == [0, 0]
    assert [len(k) for k in close_pairs(poses[:3])] == [1, 1]


def test_close_poses_of_two_paths_by_hand() -> None:
    """Marks at 0, 1, 2 and 3 m; the estimate is 10 % too long and turns by 0.1, -0.2 and 0.4 rad."""
    true = np.column_stack((np.arange(7) / 2, np.zeros(7), np.zeros(7)))
    yaw = np.array([0.0, 9.0, 0.1, 9.0, -0.1, 9.0, 0.3])
    found = constraint_error_summary(true, np.column_stack((1.1 * true[:, 0], np.zeros(7), yaw)))
    pairs = [(0, 2), (0, 4), (2, 4), (2, 6), (4, 6)]  # at most 2 m apart
    a, b = np.array(pairs).T
    # The estimated step in its own first frame, less the true one.
    step = 1.1 * (true[b, 0] - true[a, 0])
    shift = np.hypot(step * np.cos(yaw[a]) - step / 1.1, step * np.sin(yaw[a]))
    turn = np.abs(yaw[b] - yaw[a])
    assert found.relations == 5
    assert (found.translation_mean, found.translation_std) == pytest.approx((shift.mean(), shift.std()))
    assert (found.rotation_mean, found.rotation_std) == pytest.approx((turn.mean(), turn.std()))
    assert constraint_error_summary(true[:2], true[:2]) is None


BAD = {
    "too few numbers": (b"1 2 3\n", "needs 8 numbers"),
    "words": (
        b"1 2 three 4 5 6 7 8\n",
        "not readable as relations: could not convert string to float: 'three'",
    ),
    "not a number": (b"1 2 nan 4 5 6 7 8\n", "needs 8 numbers"),
    "empty": (b"# nothing\n\n", "holds no relation"),
    "binary": (b"\x89PNG\r\n\x1a\n\x00", "not readable as relations"),
    "cut gzip": (gzip.compress(b"1 2 3 4 5 6 7 8\n" * 99)[:-12], "damaged or cut off"),
    "wrong gzip": (gzip.compress(b"1 2 3 4 5 6 7 8\n" * 99)[:12] + b"xxxx", "damaged or cut off"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_relations_are_one_line(tmp_path: Path, case: str) -> None:
    content, expected = BAD[case]
    path = tmp_path / "r.relations"
    path.write_bytes(content)
    with refused(path, expected):
        read_constraints(path)


def test_missing_relations(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"none\.relations: cannot be read: No such file or directory$"):
        read_constraints(tmp_path / "none.relations")
