"""Trajectory errors: an estimate against the truth, in the plane and in space.

The metrics are those of Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012):
absolute trajectory error (ATE, Eq. 4) and relative pose error (RPE, Eqs. 1-3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lirs_validation.metrics.alignment import (
    MAX_GAP,
    associated,
    move_poses,
    planar,
    rigid_alignment,
    rms,
    scan_coverage,
    wrap_angles,
)
from lirs_validation.metrics.relative_pose_error import (
    ConstraintErrorSummary,
    RelativePoseError,
    constraint_error_summary,
    pairs_by_path,
    pairs_by_time,
    relative_pose_error,
)
from lirs_wct import ConfigError, Pose2, Pose3, Trajectory
from lirs_wct.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class TrajectoryErrors:
    """The errors of one estimated trajectory against the true one.

    Attributes:
        ate_rmse: root mean square position error after rigid alignment without scale, meters.
        ate_max: largest position error after that alignment, meters.
        ate_rmse_unaligned: the same without any alignment: both start at the true start pose, meters.
        yaw_rmse: root mean square yaw error after alignment, radians.
        rpe_metre: relative error per meter driven; None where the path is shorter than a meter.
        rpe_second: relative error per second; None where it lasts less than a second.
        relations: error of the relative-pose constraints between close poses; None where the path is
            shorter than a meter.
        final_drift: distance between the last two poses without alignment, meters.
        final_yaw_drift: absolute difference of the last two yaws without alignment, radians.
        length: length of the true path between the first and the last compared pose, meters.
        poses: how many pairs of poses were compared.
        scan_coverage: share of the true poses, one a scan, with an estimate at their stamp.
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
        T_world_map: where the map frame lies in the world: the true start pose (None: the same frame).

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
        ate_rmse_3d: root mean square position error after rigid alignment without scale, meters.
        ate_max_3d: largest position error after that alignment, meters.
        ate_rmse_3d_unaligned: the same without alignment: both start at the true start pose, meters.
        rotation_rmse_3d: root mean square angle between true and estimated attitude, radians; without
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
    turned = _rotations(truth.quaternions[i]).inv() * _rotations(estimate.quaternions[j])
    return SpatialErrors(
        ate_rmse_3d=rms(error),
        ate_max_3d=float(error.max()),
        ate_rmse_3d_unaligned=rms(np.linalg.norm(est - true, axis=1)),
        rotation_rmse_3d=rms(np.asarray(turned.magnitude())),
    )


def spatial_alignment(source: FloatArray, target: FloatArray) -> Pose3:
    """Return the least-squares `T_target_source` from points (n, 3) to points (n, 3).

    Umeyama (PAMI 1991), Eqs. 39-42 without scale. Points on a line leave the turn about it open; that of the
    singular value decomposition is then taken.
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    mirrored = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R = U @ np.diag((1.0, 1.0, mirrored)) @ Vt
    t = target.mean(axis=0) - R @ source.mean(axis=0)
    return Pose3.from_arrays(t, Rotation.from_matrix(R).as_quat(scalar_first=True))


def _rotations(quaternions: FloatArray) -> Rotation:
    return Rotation.from_quat(quaternions, scalar_first=True)
