"""Accuracy of a mapped log's trajectory against a reference."""

from __future__ import annotations

import numpy as np
import pytest

from lirs_validation.metrics.log_accuracy import reference_errors
from lirs_validation.metrics.planar import rms
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory


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
