"""The relation metric against cases computed by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from lirs_validation.relations import Relation, pose_at, read_relations, relation_errors
from lirs_wct.errors import SourceError
from lirs_wct.pose import Pose2
from lirs_wct.trajectory import Trajectory

STAMPS = [0.0, 1.0, 2.0]


def test_the_frame_of_the_estimate_does_not_matter() -> None:
    poses = [Pose2(), Pose2(1.0, 0.0, 0.3), Pose2(2.0, 0.5, -0.2)]
    relations = (Relation(0.0, 2.0, poses[2]), Relation(1.0, 2.0, poses[1].inverse() @ poses[2]))
    estimate = Trajectory.from_poses(STAMPS, [Pose2(5.0, -3.0, 2.0) @ p for p in poses])
    errors = relation_errors(estimate, relations, estimate)
    np.testing.assert_allclose(errors.translation, 0, atol=1e-12)
    np.testing.assert_allclose(errors.rotation, 0, atol=1e-12)


def test_errors_are_those_of_the_relative_pose() -> None:
    estimate = Trajectory.from_poses(STAMPS, [Pose2(), Pose2(1.0, 0.0, 0.0), Pose2(1.0, 0.0, 0.0)])
    errors = relation_errors(estimate, (Relation(0.0, 1.0, Pose2(0.7, 0.4, -0.1)),), estimate)
    assert errors.translation[0] == pytest.approx(math.hypot(0.3, 0.4))
    assert errors.rotation[0] == pytest.approx(0.1)


def test_relations_outside_are_counted() -> None:
    estimate = Trajectory.from_poses(STAMPS, [Pose2(float(t), 0.0, 0.0) for t in STAMPS])
    errors = relation_errors(
        estimate, (Relation(0.0, 60.0, Pose2()), Relation(0.0, 1.0, Pose2(1.0))), estimate
    )
    assert (len(errors.translation), errors.outside) == (1, 1)


def test_far_stamps_are_reached_by_odometry() -> None:
    odometry = Trajectory.from_poses([0.0, 2.0], [Pose2(7.0, 0.0, 0.0), Pose2(9.0, 0.0, 0.0)])
    estimate = Trajectory.from_poses([0.0], [Pose2(0.0, 0.0, math.pi / 2)])
    assert pose_at(estimate, 0.05, odometry).y == 0.0
    far = pose_at(estimate, 0.5, odometry)
    assert (far.x, far.y) == (pytest.approx(0.0), pytest.approx(0.5))


def test_bad_relations(tmp_path: Path) -> None:
    path = tmp_path / "r.relations"
    path.write_text("1 2 3\n")
    with pytest.raises(SourceError, match="needs 8 numbers"):
        read_relations(path)
