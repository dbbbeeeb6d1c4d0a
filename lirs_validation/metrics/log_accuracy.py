"""Accuracy of a mapped log's trajectory: relative-pose constraints, and a reference trajectory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lirs_validation.metrics.alignment import (
    associated,
    move_poses,
    planar,
    rigid_alignment,
    rms,
    wrap_angles,
)
from lirs_validation.metrics.relative_pose_error import (
    ConstraintErrors,
    RelativePoseConstraint,
    constraint_errors,
)
from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import Pose2, Trajectory

WITHIN = 0.5
"""A reference pose is compared with the nearest scan, at most so many seconds away."""
FEWEST = 2
"""Poses that an alignment needs."""


@dataclass(frozen=True)
class ReferenceErrors:
    """Errors at the reference poses with a scan near by, after rigid alignment without scale.

    Attributes:
        stamps: (n,) seconds.
        position: (n,) meters.
        yaw: (n,) radians, not negative.
        outside: reference poses without a scan near by.
        T_map_reference: where the reference's frame lies in the map, so that the two can be drawn together.
    """

    stamps: FloatArray
    position: FloatArray
    yaw: FloatArray
    outside: int
    T_map_reference: Pose2


@dataclass(frozen=True)
class Accuracy:
    """Errors of a trajectory; None if not requested, or nothing can be compared."""

    constraints: ConstraintErrors | None = None
    reference: ReferenceErrors | None = None

    def metrics(self) -> dict[str, Any]:
        """Return the metrics as a record holds them."""
        return {
            "relations": None if self.constraints is None else _of_constraints(self.constraints),
            "reference": None if self.reference is None else _of_reference(self.reference),
        }


def trajectory_accuracy(
    estimate: Trajectory,
    odometry: Trajectory,
    constraints: Sequence[RelativePoseConstraint] | None,
    reference: Trajectory | None,
) -> Accuracy:
    """Compare an estimate in the map frame with relations and reference."""
    return Accuracy(
        None if constraints is None else constraint_errors(estimate, constraints, odometry),
        None if reference is None else reference_errors(estimate, reference),
    )


def reference_errors(estimate: Trajectory, reference: Trajectory) -> ReferenceErrors:
    """Compare each reference pose with the nearest scan's (ATE of Sturm et al. 2012, Eq. 4, in the plane)."""
    i, j = associated(reference.stamps, estimate.stamps, max_gap=WITHIN)
    outside = len(reference) - len(i)
    if len(i) < FEWEST:
        nothing = np.empty(0)
        return ReferenceErrors(nothing, nothing, nothing, outside, Pose2())
    true, found = planar(reference)[i], planar(estimate)[j]
    T_reference_map = rigid_alignment(found[:, :2], true[:, :2])
    aligned = move_poses(found, T_reference_map)
    return ReferenceErrors(
        reference.stamps[i],
        np.linalg.norm(aligned[:, :2] - true[:, :2], axis=1),
        np.abs(wrap_angles(aligned[:, 2] - true[:, 2])),
        outside,
        T_reference_map.inverse(),
    )


def _of_constraints(errors: ConstraintErrors) -> dict[str, Any]:
    turn = np.degrees(errors.rotation)
    some = len(turn) > 0
    return {
        "translation_mean": float(errors.translation.mean()) if some else None,
        "translation_std": float(errors.translation.std()) if some else None,
        "rotation_mean_deg": float(turn.mean()) if some else None,
        "rotation_std_deg": float(turn.std()) if some else None,
        "used": len(turn),
        "outside": errors.outside,
    }


def _of_reference(errors: ReferenceErrors) -> dict[str, Any]:
    some = len(errors.position) > 0
    return {
        "ate_rmse": rms(errors.position) if some else None,
        "ate_max": float(errors.position.max()) if some else None,
        "yaw_rmse_deg": math.degrees(rms(errors.yaw)) if some else None,
        "used": len(errors.position),
        "outside": errors.outside,
    }
