"""How far an estimated trajectory lies from the true one in space.

The absolute trajectory error of Sturm et al. (IROS 2012, Eq. 4), as `metrics.trajectory` has it in the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lirs_validation.metrics.association import MAX_GAP, associated
from lirs_validation.metrics.planar import rms
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.trajectory import Trajectory


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


def spatial_errors(truth: Trajectory, estimate: Trajectory, *, max_gap: float = MAX_GAP) -> SpatialErrors:
    """Compare an estimate with the truth, both in the world frame.

    Raises:
        ConfigError: fewer than two poses share a moment.
    """
    i, j = associated(truth.stamps, estimate.stamps, max_gap=max_gap)
    if len(i) < 2:
        raise ConfigError(f"a trajectory error needs at least 2 poses in common, got {len(i)}")
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
    """Return `T_target_source` that brings points (n, 3) nearest to points (n, 3) in the least-squares sense.

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
