"""Trajectory errors: an estimate against the truth, aligned in the plane and in space.

The metrics are those of Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012):
absolute trajectory error (ATE, Eq. 4) after rigid alignment, and relative pose error (RPE, Eqs. 1-3) of the
motion between pairs of poses, without any alignment. Relations between close poses are those of Kuemmerle et
al., "On measuring the accuracy of SLAM algorithms" (Autonomous Robots 2009).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from lirs_wct import ConfigError, FloatArray, IntArray, Pose2, Pose3, Trajectory
from lirs_wct.geometry import wrap_angles

MAX_GAP = 0.02
"""Poses whose stamps differ by more than this (seconds) are not the same moment."""
MIN_PATH = 1.0
"""Meters of path below which a trajectory does not say how it is turned."""
CLOSE = 2.0
"""Constraints tie poses this near each other, meters: scans at both poses show the same places."""
SPACING = 1.0
"""Path between two poses that constraints are made of, meters."""


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
    """Compare an estimate in the map frame with the truth in the world frame.

    `T_world_map` is the true start pose; None = the frames are the same. Fewer than two common poses are
    refused.
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


@dataclass(frozen=True)
class ErrorSpread:
    """Interval of the central path errors of several drives.

    At each end about 5 % of the drives are left out: none of fewer than 10, one of fewer than 30.

    Attributes:
        inside: Number of drives that were not left out and have an error.
        total: Number of drives.
        low: Smallest error of the interval, meters.
        high: Largest error of the interval, meters.
    """

    inside: int
    total: int
    low: float
    high: float

    @classmethod
    def of(cls, errors: Iterable[float | None]) -> ErrorSpread | None:
        """Return the interval; a drive without an error counts as the largest. None if none has one."""
        values = list(errors)
        ends = (len(values) + 10) // 20
        central = sorted(error for error in values if error is not None)[ends : len(values) - ends]
        return cls(len(central), len(values), central[0], central[-1]) if central else None

    @property
    def count(self) -> str:
        """Number of drives inside, as in `8 of 10`."""
        return f"{self.inside} of {self.total}" if self.inside < self.total else f"all {self.total}"


CHI2_95 = 5.991
"""95 % quantile of the squared Mahalanobis distance in the plane, -2 log .05."""
ROUNDING = 1e-9
"""Variance that an estimate has by its numbers alone, square meters."""


def inside_95(
    truth: FloatArray, estimate: FloatArray, covariances: Sequence[FloatArray | None]
) -> float | None:
    """Return the share of planar positions within their claimed 95 % ellipse.

    Poses (n, 3) are in one frame, covariances (3, 3) of x, y, yaw in its axes. Those without one do not
    count; None if all are.
    """
    claimed = [k for k, covariance in enumerate(covariances) if covariance is not None]
    if not claimed:
        return None
    variances, axes = np.linalg.eigh(np.array([covariances[k] for k in claimed])[:, :2, :2])
    errors = np.einsum("nij,ni->nj", axes, (estimate - truth)[claimed, :2])
    return float(np.mean((errors**2 / np.maximum(variances, ROUNDING)).sum(axis=1) <= CHI2_95))


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
    """Compare an estimate with the truth in the world frame, over two common poses."""
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
    """Root mean square errors (meters, radians) over pairs of poses one `delta` apart."""

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
    """Return consecutive pairs of planar poses (n, 3), `delta` meters of path apart."""
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


@dataclass(frozen=True, kw_only=True)
class ConstraintErrorSummary:
    """Absolute errors (meters, radians) of the constraints between close poses.

    Standard deviations are those of all pairs, whenever the poses were passed.
    """

    translation_mean: float
    translation_std: float
    rotation_mean: float
    rotation_std: float
    relations: int


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


@dataclass(frozen=True, kw_only=True)
class StartAlignment:
    """Rigid motion that aligns an estimate with the truth, as for the ATE.

    Attributes:
        T_world_aligned: Motion of the mapper's path and map, in the world frame, to the best fit.
        shift: Distance by which it moves the start pose, meters.
        turn: Angle by which it turns, radians, not negative.
    """

    T_world_aligned: Pose2
    shift: float
    turn: float


def start_alignment(truth: Trajectory, estimate: Trajectory) -> StartAlignment | None:
    """Align an estimate with the truth; None without two poses and a meter in common.

    Both are in the world frame; the truth begins at the start pose, the estimate was moved by it.
    """
    i, j = associated(truth.stamps, estimate.stamps)
    if len(i) < 2 or np.linalg.norm(np.diff(truth.xy[i], axis=0), axis=1).sum() < MIN_PATH:
        return None
    T = rigid_alignment(estimate.xy[j], truth.xy[i])
    start = truth.pose2(0)
    return StartAlignment(T_world_aligned=T, shift=(T @ start).distance(start), turn=abs(T.yaw))


def associated(
    first: FloatArray, second: FloatArray, *, max_gap: float = MAX_GAP
) -> tuple[IntArray, IntArray]:
    """Pair each stamp of the shorter list with the nearest of the longer.

    Returns the indices of both. The lists increase; stamps of a pair differ by at most `max_gap` seconds.
    """
    if len(first) > len(second):
        j, i = associated(second, first, max_gap=max_gap)
        return i, j
    if len(first) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    near = nearest(second, first)
    kept = np.flatnonzero(np.abs(second[near] - first) <= max_gap)
    return kept.astype(np.int64), near[kept]


def nearest(stamps: FloatArray, wanted: FloatArray) -> IntArray:
    """Return (n,) indices of the nearest increasing stamps (m,), of two the earlier."""
    after = np.minimum(np.searchsorted(stamps, wanted), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(wanted - stamps[before] <= stamps[after] - wanted, before, after).astype(np.int64)


def scan_coverage(scans: FloatArray, poses: FloatArray) -> float:
    """Return the share of scans with a pose at their stamp; 0 of no scans.

    A pose is at a scan's stamp where it is at most 0.02 s away, and nearer than half the scans' period: poses
    of every second scan cover half of them, however fast they follow each other. Stamps increase, in seconds.
    """
    if len(scans) == 0 or len(poses) == 0:
        return 0.0
    steps = np.diff(scans)
    steps = steps[steps > 0]
    gap = min(MAX_GAP, 0.49 * float(np.median(steps))) if len(steps) else MAX_GAP
    return float((np.abs(poses[nearest(poses, scans)] - scans) <= gap).mean())


def planar(trajectory: Trajectory) -> FloatArray:
    """Return (n, 3): x, y in meters, yaw in radians."""
    return np.column_stack((trajectory.xy, trajectory.yaw))


def move_poses(poses: FloatArray, T_new_frame: Pose2) -> FloatArray:
    """Return planar poses (n, 3) expressed in another frame."""
    return np.column_stack((T_new_frame.apply(poses[:, :2]), wrap_angles(poses[:, 2] + T_new_frame.yaw)))


def motion(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return (n, 3) the poses b expressed in the poses a."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    d = b[:, :2] - a[:, :2]
    return np.column_stack((c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], b[:, 2] - a[:, 2]))


def rigid_alignment(source: FloatArray, target: FloatArray) -> Pose2:
    """Return the least-squares `T_target_source` from points (n, 2) to points (n, 2).

    The plane's closed form of Umeyama (PAMI 1991, Eqs. 39-42) without scale: with both sets centered,
    the best rotation has the angle of (sum of dot products, sum of cross products).
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    dot = float(np.sum(a * b))
    cross = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    turn = Pose2(yaw=math.atan2(cross, dot) if dot or cross else 0.0)
    x, y = (target.mean(axis=0) - turn.apply(source.mean(axis=0))).tolist()
    return Pose2(x, y, turn.yaw)


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


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
