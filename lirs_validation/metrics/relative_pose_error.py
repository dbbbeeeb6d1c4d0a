"""Relative pose error (RPE): errors of the motion between pairs of poses, without any alignment.

Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012), Eqs. 1-3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from lirs_validation.metrics.alignment import associated, motion, nearest, planar, rms, wrap_angles
from lirs_wct import Pose2, SourceError, Trajectory
from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.files import read_gzipped


@dataclass(frozen=True, kw_only=True)
class RelativePoseError:
    """Relative pose error over pairs of poses that lie one `delta` apart.

    Attributes:
        translation_rmse: root mean square of the translational error of a pair, meters.
        rotation_rmse: root mean square of the rotational error of a pair, radians.
        pairs: how many pairs were compared.
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


PROPAGATED = 0.1
"""A pose farther than this from a constraint's stamp is propagated there by odometry, seconds."""
CLOSE = 2.0
"""Constraints tie poses this near each other, meters: scans at both poses show the same places."""
SPACING = 1.0
"""Path between two poses that constraints are made of, meters."""


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
        outside: constraints that were left out.
        stamps: (n,) seconds, the earlier stamp of each constraint.
    """

    translation: FloatArray
    rotation: FloatArray
    outside: int
    stamps: FloatArray


@dataclass(frozen=True, kw_only=True)
class ConstraintErrorSummary:
    """Error of the constraints between poses that lie close together, whenever they were passed.

    Attributes:
        translation_mean: mean translational error of a constraint, meters.
        translation_std: its standard deviation, meters.
        rotation_mean: mean absolute rotational error of a constraint, radians.
        rotation_std: its standard deviation, radians.
        relations: number of constraints.
    """

    translation_mean: float
    translation_std: float
    rotation_mean: float
    rotation_std: float
    relations: int


def read_constraints(path: Path) -> tuple[RelativePoseConstraint, ...]:
    """Read `stamp1 stamp2 x y z roll pitch yaw` lines, gzipped or not.

    Raises:
        SourceError: the file cannot be read, holds none, or a line has not eight finite numbers.
    """
    data = read_gzipped(path)
    try:
        lines = [line.split() for line in data.decode().splitlines()]
        rows = [[float(field) for field in line] for line in lines if line and line[0][0] != "#"]
    except ValueError as error:
        raise SourceError(f"{path}: not readable as relations: {error}") from error
    if not rows:
        raise SourceError(f"{path}: holds no relation (stamp1 stamp2 x y z roll pitch yaw)")
    if any(len(row) != 8 or not np.isfinite(row).all() for row in rows):
        raise SourceError(f"{path}: a relation needs 8 numbers (stamp1 stamp2 x y z roll pitch yaw)")
    return tuple(RelativePoseConstraint(r[0], r[1], Pose2(r[2], r[3], r[7])) for r in rows)


STAMP_MARGIN = 2.0
"""Seconds around an estimate's time; constraints with a stamp outside are left out."""


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

    Kuemmerle et al. 2009, Eqs. 2-3 with absolute instead of squared errors, as in their tables. The
    constraints: of poses a meter of path apart, every two within 2 m of each other. Neighbors show the local
    error, places passed again the map's consistency.
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
    step[np.abs(there - stamps) <= PROPAGATED] = 0.0
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return poses + np.column_stack(
        (c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1], step[:, 2])
    )
