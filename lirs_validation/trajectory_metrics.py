"""How far an estimated trajectory lies from the true one, in the plane (x, y, yaw).

The figures are those of Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012):
absolute trajectory error (ATE, Eq. 4) and relative pose error (RPE, Eqs. 1-3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2
from lirs_wct.trajectory import Trajectory

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_GAP = 0.02
"""Poses whose stamps differ by more than this (seconds) are not the same moment."""


@dataclass(frozen=True, kw_only=True)
class RelativeError:
    """Relative pose error over pairs of poses that lie one `delta` apart.

    Attributes:
        translation_rmse: root mean square of the translational error of a pair, metres.
        rotation_rmse: root mean square of the rotational error of a pair, radians.
        pairs: how many pairs were compared.
    """

    translation_rmse: float
    rotation_rmse: float
    pairs: int


@dataclass(frozen=True, kw_only=True)
class TrajectoryErrors:
    """The errors of one estimated trajectory against the true one.

    Attributes:
        ate_rmse: root mean square position error after rigid alignment without scale, metres.
        ate_max: largest position error after that alignment, metres.
        ate_rmse_unaligned: the same without any alignment: both start at the true start pose, metres.
        yaw_rmse: root mean square yaw error after alignment, radians.
        rpe_metre: relative error per metre driven; None where the path is shorter than a metre.
        rpe_second: relative error per second; None where it lasts less than a second.
        final_drift: distance between the last two poses without alignment, metres.
        final_yaw_drift: absolute difference of the last two yaws without alignment, radians.
        length: length of the true path between the first and the last compared pose, metres.
        poses: how many pairs of poses were compared.
    """

    ate_rmse: float
    ate_max: float
    ate_rmse_unaligned: float
    yaw_rmse: float
    rpe_metre: RelativeError | None
    rpe_second: RelativeError | None
    final_drift: float
    final_yaw_drift: float
    length: float
    poses: int


def trajectory_errors(
    truth: Trajectory, estimate: Trajectory, *, T_world_map: Pose2 | None = None, max_gap: float = MAX_GAP
) -> TrajectoryErrors:
    """Compare an estimate with the truth.

    Args:
        truth: true poses in the world frame.
        estimate: estimated poses in the map frame.
        T_world_map: where the map frame lies in the world: the true start pose (None: the same frame).
        max_gap: largest difference of two stamps that count as one moment, seconds.

    Raises:
        ConfigError: fewer than two poses share a moment.
    """
    i, j = associated(truth.stamps, estimate.stamps, max_gap=max_gap)
    if len(i) < 2:
        raise ConfigError(
            f"a trajectory error needs at least 2 poses within {max_gap} s of each other, got {len(i)} of "
            f"{len(truth)} true and {len(estimate)} estimated poses"
        )
    true, est = planar(truth)[i], moved(planar(estimate)[j], T_world_map or Pose2())
    aligned = moved(est, rigid_alignment(est[:, :2], true[:, :2]))
    error = np.linalg.norm(aligned[:, :2] - true[:, :2], axis=1)
    raw = np.linalg.norm(est[:, :2] - true[:, :2], axis=1)
    return TrajectoryErrors(
        ate_rmse=_rms(error),
        ate_max=float(error.max()),
        ate_rmse_unaligned=_rms(raw),
        yaw_rmse=_rms(wrapped(aligned[:, 2] - true[:, 2])),
        rpe_metre=relative_error(true, est, pairs_by_path(true, 1.0)),
        rpe_second=relative_error(true, est, pairs_by_time(truth.stamps[i], 1.0)),
        final_drift=float(raw[-1]),
        final_yaw_drift=float(abs(wrapped(est[-1:, 2] - true[-1:, 2])[0])),
        length=float(np.linalg.norm(np.diff(true[:, :2], axis=0), axis=1).sum()),
        poses=len(i),
    )


def associated(first: Array, second: Array, *, max_gap: float = MAX_GAP) -> tuple[Indices, Indices]:
    """Pair each stamp of the shorter list with the nearest of the longer, at most `max_gap` apart.

    Args:
        first: (n,) seconds, increasing.
        second: (m,) seconds, increasing.
        max_gap: seconds.

    Returns:
        Two index vectors of one length, into `first` and `second`.
    """
    if len(first) > len(second):
        j, i = associated(second, first, max_gap=max_gap)
        return i, j
    if len(first) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    after = np.clip(np.searchsorted(second, first), 0, len(second) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(second[after] - first) < np.abs(first - second[before]), after, before)
    kept = np.flatnonzero(np.abs(second[nearest] - first) <= max_gap)
    return kept.astype(np.int64), nearest[kept].astype(np.int64)


def rigid_alignment(source: Array, target: Array) -> Pose2:
    """Return `T_target_source` that brings points (n, 2) nearest to points (n, 2) in the least-squares sense.

    The plane's closed form of Umeyama (PAMI 1991, Eqs. 39-42) without scale: with both sets centred,
    the best rotation has the angle of (sum of dot products, sum of cross products).
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    dot = float(np.sum(a * b))
    cross = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    turn = Pose2(yaw=math.atan2(cross, dot) if dot or cross else 0.0)
    x, y = (target.mean(axis=0) - turn.apply(source.mean(axis=0))).tolist()
    return Pose2(x, y, turn.yaw)


def relative_error(true: Array, estimate: Array, pairs: tuple[Indices, Indices]) -> RelativeError | None:
    """Compare the motions of pairs of planar poses (n, 3); None where there is no pair.

    Sturm et al. 2012, Eq. 1: E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j).
    """
    i, j = pairs
    if len(i) == 0:
        return None
    q, p = _motion(true[i], true[j]), _motion(estimate[i], estimate[j])
    # |E's translation| = |p's - q's translation|, as both are expressed in the first pose's frame.
    shift = np.linalg.norm(p[:, :2] - q[:, :2], axis=1)
    turn = wrapped(p[:, 2] - q[:, 2])
    return RelativeError(translation_rmse=_rms(shift), rotation_rmse=_rms(turn), pairs=len(i))


def pairs_by_path(poses: Array, delta: float) -> tuple[Indices, Indices]:
    """Return consecutive pairs of planar poses (n, 3), each `delta` metres of path apart or just above."""
    steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    marks, driven = [0], 0.0
    for k, step in enumerate(steps.tolist(), start=1):
        driven += step
        if driven >= delta:
            marks.append(k)
            driven = 0.0
    ids = np.asarray(marks, dtype=np.int64)
    return ids[:-1], ids[1:]


def pairs_by_time(stamps: Array, delta: float) -> tuple[Indices, Indices]:
    """Return every pair of stamps (n,) that are `delta` seconds apart, to the nearest stamp."""
    gap = float(np.median(np.diff(stamps))) if len(stamps) > 1 else delta
    late = np.flatnonzero(stamps <= stamps[-1] - delta + gap / 2)
    ahead, back = associated(stamps[late] + delta, stamps, max_gap=gap)
    return late[ahead].astype(np.int64), back


def planar(trajectory: Trajectory) -> Array:
    """Return (n, 3): x, y in metres, yaw in radians."""
    return np.column_stack((trajectory.xy, trajectory.yaw))


def moved(poses: Array, T_new_frame: Pose2) -> Array:
    """Return planar poses (n, 3) expressed in another frame."""
    return np.column_stack((T_new_frame.apply(poses[:, :2]), wrapped(poses[:, 2] + T_new_frame.yaw)))


def wrapped(angles: Array) -> Array:
    """Return angles in [-pi, pi]."""
    result: Array = np.remainder(angles + math.pi, math.tau) - math.pi
    return result


def _motion(a: Array, b: Array) -> Array:
    """Return (n, 3) the poses b expressed in the poses a."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    d = b[:, :2] - a[:, :2]
    return np.column_stack((c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], b[:, 2] - a[:, 2]))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
