"""The relation metric against cases computed by hand."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lirs_validation.metrics.relative_pose_constraints import (
    RelativePoseConstraint,
    constraint_errors,
    poses_at,
    read_constraints,
)
from lirs_wct.errors import SourceError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory

STAMPS = [0.0, 1.0, 2.0]


def test_the_frame_of_the_estimate_does_not_matter() -> None:
    poses = [Pose2(), Pose2(1.0, 0.0, 0.3), Pose2(2.0, 0.5, -0.2)]
    relations = (
        RelativePoseConstraint(0.0, 2.0, poses[2]),
        RelativePoseConstraint(1.0, 2.0, poses[1].inverse() @ poses[2]),
    )
    estimate = Trajectory.from_poses(STAMPS, [Pose2(5.0, -3.0, 2.0) @ p for p in poses])
    errors = constraint_errors(estimate, relations, estimate)
    np.testing.assert_allclose(errors.translation, 0, atol=1e-12)
    np.testing.assert_allclose(errors.rotation, 0, atol=1e-12)


def test_errors_are_those_of_the_relative_pose() -> None:
    estimate = Trajectory.from_poses(STAMPS, [Pose2(), Pose2(1.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0)])
    errors = constraint_errors(estimate, (RelativePoseConstraint(0.0, 1.0, Pose2(0.7, 0.4, -0.1)),), estimate)
    assert errors.translation[0] == pytest.approx(math.hypot(0.3, 0.4))
    assert errors.rotation[0] == pytest.approx(0.1)


def test_relations_outside_are_counted() -> None:
    estimate = Trajectory.from_poses(STAMPS, [Pose2(float(t), 0.0, 0.0) for t in STAMPS])
    errors = constraint_errors(
        estimate,
        (RelativePoseConstraint(0.0, 60.0, Pose2()), RelativePoseConstraint(0.0, 1.0, Pose2(1.0))),
        estimate,
    )
    assert (len(errors.translation), errors.outside) == (1, 1)


def test_far_stamps_are_reached_by_odometry() -> None:
    odometry = Trajectory.from_poses([0.0, 2.0], [Pose2(7.0, 0.0, 0.0), Pose2(9.0, 0.0, 0.0)])
    estimate = Trajectory.from_poses([0.0], [Pose2(0.0, 0.0, math.pi / 2)])
    near, far = poses_at(estimate, np.array((0.05, 0.5)), odometry)
    np.testing.assert_allclose(near, (0, 0, math.pi / 2))
    np.testing.assert_allclose(far, (0, 0.5, math.pi / 2), atol=1e-12)


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
    """Linear between the neighbours, the end beyond the ends."""
    stamp = float(np.clip(stamp, track.stamps[0], track.stamps[-1]))
    j = int(np.clip(np.searchsorted(track.stamps, stamp), 1, len(track) - 1))
    a, b = track.pose2(j - 1), track.pose2(j)
    t = (stamp - track.stamps[j - 1]) / (track.stamps[j] - track.stamps[j - 1])
    yaw = a.yaw + t * math.remainder(b.yaw - a.yaw, math.tau)
    return Pose2(a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), yaw)


BAD = {
    "too few numbers": (b"1 2 3\n", "needs 8 numbers"),
    "words": (b"1 2 three 4 5 6 7 8\n", "not readable as relations"),
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
    with pytest.raises(SourceError, match=expected) as told:
        read_constraints(path)
    assert str(told.value).startswith(str(path))
    assert "\n" not in str(told.value)


def test_missing_relations(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="No such file"):
        read_constraints(tmp_path / "none.relations")
