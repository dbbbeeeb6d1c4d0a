"""Relative pose error (RPE): errors of the motion between pairs of poses, without any alignment.

Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012), Eqs. 1-3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lirs_validation.metrics.association import associated
from lirs_validation.metrics.planar import motion, rms, wrapped
from lirs_wct.arrays import FloatArray, IntArray


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
    """Compare the motions of pairs of planar poses (n, 3); None where there is no pair.

    Sturm et al. 2012, Eq. 1: E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j).
    """
    if len(pairs[0]) == 0:
        return None
    shift, turn = motion_errors(true, estimate, pairs)
    return RelativePoseError(translation_rmse=rms(shift), rotation_rmse=rms(turn), pairs=len(shift))


def pairs_by_path(poses: FloatArray, delta: float) -> tuple[IntArray, IntArray]:
    """Return consecutive pairs of planar poses (n, 3), each `delta` meters of path apart or just above."""
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
    return np.linalg.norm(p[:, :2] - q[:, :2], axis=1), wrapped(p[:, 2] - q[:, 2])
