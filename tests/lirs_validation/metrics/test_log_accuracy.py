"""Accuracy of a mapped log's trajectory against a reference."""

import math

import numpy as np
import pytest

from lirs_validation.metrics.alignment import rms
from lirs_validation.metrics.trajectory import (
    Accuracy,
    ConstraintErrors,
    ReferenceErrors,
    RelativePoseConstraint,
    reference_errors,
    trajectory_accuracy,
    trajectory_errors,
)
from lirs_wct.geometry.pose import Pose2, Trajectory


def test_errors_are_those_after_alignment() -> None:
    """A path seen from another frame; then one with a wrong corner, against the metric that evo confirms."""
    true = [Pose2(0.0, 0.0), Pose2(4.0, 0.0), Pose2(4.0, 4.0), Pose2(0.0, 4.0)]
    reference = Trajectory.from_poses([0.0, 1.0, 2.0, 9.0], true)
    estimate = Trajectory.from_poses([0.0, 1.0, 2.0, 3.0], [Pose2(7.0, 1.0, 2.0) @ p for p in true])
    errors = reference_errors(estimate, reference)
    assert errors.outside == 1  # nearest scan six seconds away
    np.testing.assert_allclose(errors.position, 0, atol=1e-12)
    np.testing.assert_allclose(errors.yaw, 0, atol=1e-12)
    moved = reference.moved(errors.T_map_reference)
    np.testing.assert_allclose(moved.xy[:3], estimate.xy[:3], atol=1e-12)
    stretched = Trajectory.from_poses([0.0, 1.0, 2.0], [Pose2(0.0), Pose2(4.6), Pose2(4.0, 4.0)])
    found, known = reference_errors(stretched, reference).position, trajectory_errors(reference, stretched)
    assert found.max() == pytest.approx(known.ate_max)
    assert rms(found) == pytest.approx(known.ate_rmse)
    assert known.ate_max > 0.2


def at(stamps: list[float]) -> Trajectory:
    return Trajectory.from_poses(stamps, [Pose2(t, 0.0, 0.0) for t in stamps])


@pytest.mark.parametrize(("late", "used"), [(0.499, 2), (0.501, 1)])
def test_a_scan_half_a_second_away_is_compared(late: float, used: int) -> None:
    errors = reference_errors(at([0.0, 10.0 + late]), at([0.0, 10.0, 50.0]))
    assert errors.outside == 3 - used
    # A single pose cannot be aligned: nothing is said of it.
    assert len(errors.position) == len(errors.yaw) == len(errors.stamps) == (2 if used == 2 else 0)
    assert errors.T_map_reference == Pose2() or used == 2


def test_yaw_errors_are_not_negative() -> None:
    reference = Trajectory.from_poses([0.0, 1.0, 2.0], [Pose2(0.0), Pose2(1.0), Pose2(2.0)])
    turned = Trajectory.from_poses(
        [0.0, 1.0, 2.0], [Pose2(0.0, 0.0, -0.3), Pose2(1.0, 0.0, 0.2), Pose2(2.0, 0.0, -3.0)]
    )
    np.testing.assert_allclose(reference_errors(turned, reference).yaw, (0.3, 0.2, 3.0), atol=1e-9)


def test_metrics_of_the_record_by_hand() -> None:
    constraints = ConstraintErrors(np.array([0.1, 0.3]), np.radians([1.0, 4.0]), 5, np.array([0.0, 1.0]))
    reference = ReferenceErrors(
        np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.radians([6.0, 8.0]), 7, Pose2()
    )
    found = Accuracy(constraints, reference).metrics()
    assert found["relations"] == pytest.approx(
        {
            "translation_mean": 0.2,
            "translation_std": 0.1,
            "rotation_mean_deg": 2.5,
            "rotation_std_deg": 1.5,
            "used": 2,
            "outside": 5,
        }
    )
    assert found["reference"] == pytest.approx(
        {"ate_rmse": math.sqrt(12.5), "ate_max": 4.0, "yaw_rmse_deg": math.sqrt(50), "used": 2, "outside": 7}
    )


def test_one_error_is_enough_and_none_is_null() -> None:
    one, nothing = np.array([0.5]), np.empty(0)
    found = Accuracy(ConstraintErrors(one, one, 0, one), ReferenceErrors(one, one, one, 0, Pose2())).metrics()
    assert (found["relations"]["translation_mean"], found["relations"]["rotation_std_deg"]) == (0.5, 0.0)
    assert (found["reference"]["ate_rmse"], found["reference"]["ate_max"]) == (0.5, 0.5)
    found = Accuracy(
        ConstraintErrors(nothing, nothing, 3, nothing), ReferenceErrors(nothing, nothing, nothing, 4, Pose2())
    ).metrics()
    assert set(found["relations"].values()) == {None, 0, 3}
    assert set(found["reference"].values()) == {None, 0, 4}
    assert Accuracy().metrics() == {"relations": None, "reference": None}


def test_each_is_compared_where_it_was_asked_for() -> None:
    path, nothing = at([0.0, 1.0, 2.0]), Trajectory.from_poses([], [])
    constraints = [RelativePoseConstraint(0.0, 1.0, Pose2(1.25))]
    found = trajectory_accuracy(path, nothing, constraints, None)
    assert found.reference is None
    assert found.constraints.translation.tolist() == [0.25]
    found = trajectory_accuracy(path, nothing, None, path)
    assert found.constraints is None
    assert len(found.reference.position) == 3
