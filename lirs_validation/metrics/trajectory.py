"""Trajectory errors: an estimate against truth, relations or reference, in the plane and in space.

The metrics are those of Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012):
absolute trajectory error (ATE, Eq. 4) after rigid alignment, and relative pose error (RPE, Eqs. 1-3) of the
motion between pairs of poses, without any alignment. Relations between close poses are those of Kuemmerle et
al., "On measuring the accuracy of SLAM algorithms" (Autonomous Robots 2009).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lirs_validation.metrics.alignment import (
    MAX_GAP,
    associated,
    motion,
    move_poses,
    nearest,
    planar,
    rigid_alignment,
    rms,
    scan_coverage,
    spatial_alignment,
    wrap_angles,
)
from lirs_wct import ConfigError, FloatArray, IntArray, Pose2, Trajectory

PROPAGATION_GAP = 0.1
"""A pose farther than this from a constraint's stamp is propagated there by odometry, seconds."""
CLOSE = 2.0
"""Constraints tie poses this near each other, meters: scans at both poses show the same places."""
SPACING = 1.0
"""Path between two poses that constraints are made of, meters."""
STAMP_MARGIN = 2.0
"""Seconds around an estimate's time; constraints with a stamp outside are left out."""
REFERENCE_GAP = 0.5
"""A reference pose is compared with the nearest scan, at most so many seconds away."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryErrors:
    """The errors of one estimated trajectory against the true one.

    Attributes:
        ate_rmse: Root mean square position error after rigid alignment without scale, meters.
        ate_max: Largest position error after alignment, meters.
        ate_rmse_unaligned: Root mean square position error from a common start pose, meters.
        yaw_rmse: Root mean square yaw error after alignment, radians.
        rpe_metre: Relative error per meter driven; None of a path shorter than a meter.
        rpe_second: Relative error per second; None of a path shorter than a second.
        relations: Error of constraints between close poses; None of a path shorter than a meter.
        final_drift: Distance between the last two poses without alignment, meters.
        final_yaw_drift: Absolute difference of the last two yaws without alignment, radians.
        length: Length of the true path between the first and the last compared pose, meters.
        poses: Number of compared pairs of poses.
        scan_coverage: Share of the true poses, one a scan, with an estimate at their stamp.
    """

    ate_rmse: float
    ate_max: float
    ate_rmse_unaligned: float
    yaw_rmse: float
    rpe_metre: RelativePoseError | None
    rpe_second: RelativePoseError | None
    relations: ConstraintErrorSummary | None
    final_drift: float
    final_yaw_drift: float
    length: float
    poses: int
    scan_coverage: float


def trajectory_errors(
    truth: Trajectory, estimate: Trajectory, *, T_world_map: Pose2 | None = None
) -> TrajectoryErrors:
    """Compare an estimate with the truth.

    Args:
        truth: true poses in the world frame.
        estimate: estimated poses in the map frame.
        T_world_map: Place of the map frame in the world: the true start pose (None: the same frame).

    Raises:
        ConfigError: fewer than two poses share a moment.
    """
    i, j = associated(truth.stamps, estimate.stamps)
    if len(i) < 2:
        raise ConfigError(
            f"a trajectory error needs at least 2 poses within {MAX_GAP} s of each other, got {len(i)} of "
            f"{len(truth)} true and {len(estimate)} estimated poses"
        )
    true, est = planar(truth)[i], move_poses(planar(estimate)[j], T_world_map or Pose2())
    aligned = move_poses(est, rigid_alignment(est[:, :2], true[:, :2]))
    error = np.linalg.norm(aligned[:, :2] - true[:, :2], axis=1)
    raw = np.linalg.norm(est[:, :2] - true[:, :2], axis=1)
    return TrajectoryErrors(
        ate_rmse=rms(error),
        ate_max=float(error.max()),
        ate_rmse_unaligned=rms(raw),
        yaw_rmse=rms(wrap_angles(aligned[:, 2] - true[:, 2])),
        rpe_metre=relative_pose_error(true, est, pairs_by_path(true, 1.0)),
        rpe_second=relative_pose_error(true, est, pairs_by_time(truth.stamps[i], 1.0)),
        relations=constraint_error_summary(true, est),
        final_drift=float(raw[-1]),
        final_yaw_drift=abs(wrap_angles(est[-1:, 2] - true[-1:, 2]).item()),
        length=float(np.linalg.norm(np.diff(true[:, :2], axis=0), axis=1).sum()),
        poses=len(i),
        scan_coverage=scan_coverage(truth.stamps, estimate.stamps),
    )


@dataclass(frozen=True, kw_only=True)
class SpatialErrors:
    """The errors of one estimated trajectory against the true one, in space.

    Attributes:
        ate_rmse_3d: Root mean square position error after rigid alignment without scale, meters.
        ate_max_3d: Largest position error after alignment, meters.
        ate_rmse_3d_unaligned: Root mean square position error from a common start pose, meters.
        rotation_rmse_3d: Root mean square angle between true and estimated attitude, radians; without
            alignment, which leaves the turn about a straight path open.
    """

    ate_rmse_3d: float
    ate_max_3d: float
    ate_rmse_3d_unaligned: float
    rotation_rmse_3d: float


def spatial_errors(truth: Trajectory, estimate: Trajectory) -> SpatialErrors:
    """Compare an estimate with the truth, both in the world frame.

    At least two poses share a moment.
    """
    i, j = associated(truth.stamps, estimate.stamps)
    true, est = truth.positions[i], estimate.positions[j]
    T = spatial_alignment(est, true)
    error = np.linalg.norm(T.apply(est) - true, axis=1)
    attitude = Rotation.from_quat(truth.quaternions[i], scalar_first=True)
    turned = attitude.inv() * Rotation.from_quat(estimate.quaternions[j], scalar_first=True)
    return SpatialErrors(
        ate_rmse_3d=rms(error),
        ate_max_3d=float(error.max()),
        ate_rmse_3d_unaligned=rms(np.linalg.norm(est - true, axis=1)),
        rotation_rmse_3d=rms(np.asarray(turned.magnitude())),
    )


@dataclass(frozen=True, kw_only=True)
class RelativePoseError:
    """Relative pose error over pairs of poses that lie one `delta` apart.

    Attributes:
        translation_rmse: Root mean square of the translational error of a pair, meters.
        rotation_rmse: Root mean square of the rotational error of a pair, radians.
        pairs: Number of compared pairs.
    """

    translation_rmse: float
    rotation_rmse: float
    pairs: int


def relative_pose_error(
    true: FloatArray, estimate: FloatArray, pairs: tuple[IntArray, IntArray]
) -> RelativePoseError | None:
    """Compare motions of pairs of planar poses (n, 3); None without pairs.

    Sturm et al. 2012, Eq. 1: E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j).
    """
    if len(pairs[0]) == 0:
        return None
    shift, turn = motion_errors(true, estimate, pairs)
    return RelativePoseError(translation_rmse=rms(shift), rotation_rmse=rms(turn), pairs=len(shift))


def pairs_by_path(poses: FloatArray, delta: float) -> tuple[IntArray, IntArray]:
    """Return consecutive pairs of planar poses (n, 3), `delta` meters of path apart.

    A distance may be just above `delta`.
    """
    steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    marks, driven = [0], 0.0
    for k, step in enumerate(steps.tolist(), start=1):
        driven += step
        if driven >= delta:
            marks.append(k)
            driven = 0.0
    ids = np.asarray(marks, dtype=np.int64)
    return ids[:-1], ids[1:]


def pairs_by_time(stamps: FloatArray, delta: float) -> tuple[IntArray, IntArray]:
    """Return every pair of stamps (n,) that are `delta` seconds apart, to the nearest stamp."""
    gap = float(np.median(np.diff(stamps))) if len(stamps) > 1 else delta
    late = np.flatnonzero(stamps <= stamps[-1] - delta + gap / 2)
    ahead, back = associated(stamps[late] + delta, stamps, max_gap=gap)
    return late[ahead].astype(np.int64), back


def motion_errors(
    true: FloatArray, estimate: FloatArray, pairs: tuple[IntArray, IntArray]
) -> tuple[FloatArray, FloatArray]:
    """Return (n,) translational and (n,) signed rotational errors of the motion between each pair's poses."""
    i, j = pairs
    q, p = motion(true[i], true[j]), motion(estimate[i], estimate[j])
    # |E's translation| = |p's - q's translation|, as both are expressed in the first pose's frame.
    return np.linalg.norm(p[:, :2] - q[:, :2], axis=1), wrap_angles(p[:, 2] - q[:, 2])


@dataclass(frozen=True)
class RelativePoseConstraint:
    """The true pose of the robot at `stamp_b` in its frame at `stamp_a`."""

    stamp_a: float
    stamp_b: float
    T_ab: Pose2


@dataclass(frozen=True)
class ConstraintErrors:
    """Errors of the constraints inside the trajectory's time, and how many lay outside.

    Attributes:
        translation: (n,) meters.
        rotation: (n,) radians, not negative.
        outside: Number of constraints that were left out.
        stamps: (n,) seconds, the earlier stamp of each constraint.
    """

    translation: FloatArray
    rotation: FloatArray
    outside: int
    stamps: FloatArray

    def metrics(self) -> dict[str, Any]:
        """Return the metrics as a record holds them."""
        turn = np.degrees(self.rotation)
        some = len(turn) > 0
        return {
            "translation_mean": float(self.translation.mean()) if some else None,
            "translation_std": float(self.translation.std()) if some else None,
            "rotation_mean_deg": float(turn.mean()) if some else None,
            "rotation_std_deg": float(turn.std()) if some else None,
            "used": len(turn),
            "outside": self.outside,
        }


@dataclass(frozen=True, kw_only=True)
class ConstraintErrorSummary:
    """Error of the constraints between poses that lie close together, whenever they were passed.

    Attributes:
        translation_mean: Mean translational error of a constraint, meters.
        translation_std: Standard deviation of the translational error, meters.
        rotation_mean: Mean absolute rotational error of a constraint, radians.
        rotation_std: Standard deviation of the absolute rotational error, radians.
        relations: Number of constraints.
    """

    translation_mean: float
    translation_std: float
    rotation_mean: float
    rotation_std: float
    relations: int


def constraint_errors(
    estimate: Trajectory, constraints: Sequence[RelativePoseConstraint], odometry: Trajectory
) -> ConstraintErrors:
    """Compare the estimate with the constraints.

    Args:
        estimate: poses in any frame.
        constraints: the truth.
        odometry: raw odometry over the same time, any frame, that propagates poses to the stamps; where it is
            empty, the estimate itself does.
    """
    low, high = estimate.stamps[0] - STAMP_MARGIN, estimate.stamps[-1] + STAMP_MARGIN
    stamps = np.array([(c.stamp_a, c.stamp_b) for c in constraints]).reshape(-1, 2)
    inside = (stamps.min(axis=1) >= low) & (stamps.max(axis=1) <= high)
    stamps = stamps[inside]
    true = np.array([c.T_ab.as_array() for c in constraints]).reshape(-1, 3)[inside]
    propagator = odometry if len(odometry) else estimate
    a, b = (poses_at(estimate, stamps[:, k], propagator) for k in (0, 1))
    error = motion(true, motion(a, b))
    return ConstraintErrors(
        np.linalg.norm(error[:, :2], axis=1),
        np.abs(wrap_angles(error[:, 2])),
        int((~inside).sum()),
        stamps.min(axis=1),
    )


def constraint_error_summary(true: FloatArray, estimate: FloatArray) -> ConstraintErrorSummary | None:
    """Compare relative poses of close pairs of trajectories (n, 3); None without pairs.

    Kuemmerle et al. 2009, Eqs. 2-3 with absolute instead of squared errors, as in their tables. Constraints
    join poses a meter of path apart that lie within 2 m of each other. Neighbors show the local error, places
    passed again the map's consistency.
    """
    pairs = close_pairs(true)
    if len(pairs[0]) == 0:
        return None
    shift, turn = motion_errors(true, estimate, pairs)
    turn = np.abs(turn)
    return ConstraintErrorSummary(
        translation_mean=float(shift.mean()),
        translation_std=float(shift.std()),
        rotation_mean=float(turn.mean()),
        rotation_std=float(turn.std()),
        relations=len(shift),
    )


def close_pairs(poses: FloatArray) -> tuple[IntArray, IntArray]:
    """Return pairs of close planar poses (n, 3), a meter of path apart."""
    first, second = pairs_by_path(poses, SPACING)
    marks = np.append(first, second[-1:])
    pairs = cKDTree(poses[marks, :2]).query_pairs(CLOSE, output_type="ndarray") if len(marks) else marks
    ordered = np.unique(pairs.reshape(-1, 2), axis=0)
    return marks[ordered[:, 0]], marks[ordered[:, 1]]


def poses_at(estimate: Trajectory, stamps: FloatArray, odometry: Trajectory) -> FloatArray:
    """Return (n, 3) estimated poses at the stamps.

    Distant ones are propagated from the nearest pose by odometry.

    Args:
        estimate: not empty.
        stamps: (n,) seconds.
        odometry: not empty, in any frame.
    """
    near = nearest(estimate.stamps, stamps)
    poses, there = planar(estimate)[near], estimate.stamps[near]
    step = motion(odometry.planar_at(there), odometry.planar_at(stamps))
    step[np.abs(there - stamps) <= PROPAGATION_GAP] = 0.0
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return poses + np.column_stack(
        (c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1], step[:, 2])
    )


@dataclass(frozen=True)
class ReferenceErrors:
    """Errors at the reference poses with a scan near by, after rigid alignment without scale.

    Attributes:
        stamps: (n,) seconds.
        position: (n,) meters.
        yaw: (n,) radians, not negative.
        outside: Number of reference poses without a scan near by.
        T_map_reference: Place of the reference's frame in the map, so that the two can be drawn together.
    """

    stamps: FloatArray
    position: FloatArray
    yaw: FloatArray
    outside: int
    T_map_reference: Pose2

    def metrics(self) -> dict[str, Any]:
        """Return the metrics as a record holds them."""
        some = len(self.position) > 0
        return {
            "ate_rmse": rms(self.position) if some else None,
            "ate_max": float(self.position.max()) if some else None,
            "yaw_rmse_deg": math.degrees(rms(self.yaw)) if some else None,
            "used": len(self.position),
            "outside": self.outside,
        }


@dataclass(frozen=True)
class Accuracy:
    """Errors of a trajectory; None if not requested, or nothing can be compared."""

    constraints: ConstraintErrors | None = None
    reference: ReferenceErrors | None = None

    def metrics(self) -> dict[str, Any]:
        """Return the metrics as a record holds them."""
        return {
            "relations": None if self.constraints is None else self.constraints.metrics(),
            "reference": None if self.reference is None else self.reference.metrics(),
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


def odometry_accuracy(
    odometry: Trajectory, constraints: Sequence[RelativePoseConstraint] | None, reference: Trajectory | None
) -> dict[str, Any]:
    """Return the accuracy of a log's raw odometry; empty without odometry."""
    if len(odometry) == 0:
        return {}
    return trajectory_accuracy(odometry, odometry, constraints, reference).metrics()


def reference_errors(estimate: Trajectory, reference: Trajectory) -> ReferenceErrors:
    """Compare each reference pose with the nearest scan's (ATE of Sturm et al. 2012, Eq. 4, in the plane)."""
    i, j = associated(reference.stamps, estimate.stamps, max_gap=REFERENCE_GAP)
    outside = len(reference) - len(i)
    if len(i) < 2:
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
