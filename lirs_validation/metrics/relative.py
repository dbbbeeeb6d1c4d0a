"""Errors of the motion between pairs of poses: they ask for no alignment.

Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS 2012), and Kuemmerle et al.,
"On measuring the accuracy of SLAM algorithms" (Autonomous Robots 2009).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from lirs_validation.metrics.association import associated
from lirs_validation.metrics.planar import motion, rms, wrapped
from lirs_wct.arrays import FloatArray, IntArray

CLOSE = 2.0
"""Poses this near each other are related, metres: what one scan shows, the other shows too."""
APART = 1.0
"""Of the path, so many metres lie between two poses that relations are made of."""


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
class RelationError:
    """Error of the relations between poses that lie close together, whenever they were passed.

    Attributes:
        translation_mean: mean translational error of a relation, metres.
        translation_std: its standard deviation, metres.
        rotation_mean: mean absolute rotational error of a relation, radians.
        rotation_std: its standard deviation, radians.
        relations: how many there are.
    """

    translation_mean: float
    translation_std: float
    rotation_mean: float
    rotation_std: float
    relations: int


def relative_error(
    true: FloatArray, estimate: FloatArray, pairs: tuple[IntArray, IntArray]
) -> RelativeError | None:
    """Compare the motions of pairs of planar poses (n, 3); None where there is no pair.

    Sturm et al. 2012, Eq. 1: E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j).
    """
    if len(pairs[0]) == 0:
        return None
    shift, turn = _differences(true, estimate, pairs)
    return RelativeError(translation_rmse=rms(shift), rotation_rmse=rms(turn), pairs=len(shift))


def relation_error(true: FloatArray, estimate: FloatArray) -> RelationError | None:
    """Compare the relations between close poses of planar trajectories (n, 3); None where there are none.

    Kuemmerle et al. 2009, Eqs. 2-3 with absolute instead of squared errors, as in their tables. The
    relations: of poses a metre of path apart, every two within 2 m of each other. Neighbours tell of the
    local error, places passed again of the map's consistency.
    """
    pairs = related_pairs(true)
    if len(pairs[0]) == 0:
        return None
    shift, turn = _differences(true, estimate, pairs)
    turn = np.abs(turn)
    return RelationError(
        translation_mean=float(shift.mean()),
        translation_std=float(shift.std()),
        rotation_mean=float(turn.mean()),
        rotation_std=float(turn.std()),
        relations=len(shift),
    )


def pairs_by_path(poses: FloatArray, delta: float) -> tuple[IntArray, IntArray]:
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


def pairs_by_time(stamps: FloatArray, delta: float) -> tuple[IntArray, IntArray]:
    """Return every pair of stamps (n,) that are `delta` seconds apart, to the nearest stamp."""
    gap = float(np.median(np.diff(stamps))) if len(stamps) > 1 else delta
    late = np.flatnonzero(stamps <= stamps[-1] - delta + gap / 2)
    ahead, back = associated(stamps[late] + delta, stamps, max_gap=gap)
    return late[ahead].astype(np.int64), back


def related_pairs(poses: FloatArray) -> tuple[IntArray, IntArray]:
    """Return pairs of planar poses (n, 3) that lie close together, of those a metre of path apart."""
    first, second = pairs_by_path(poses, APART)
    marks = np.append(first, second[-1:])
    pairs = cKDTree(poses[marks, :2]).query_pairs(CLOSE, output_type="ndarray") if len(marks) else marks
    ordered = np.unique(pairs.reshape(-1, 2), axis=0)
    return marks[ordered[:, 0]], marks[ordered[:, 1]]


def _differences(
    true: FloatArray, estimate: FloatArray, pairs: tuple[IntArray, IntArray]
) -> tuple[FloatArray, FloatArray]:
    """Return (n,) lengths and (n,) signed turns of what the motion between each pair's poses is off."""
    i, j = pairs
    q, p = motion(true[i], true[j]), motion(estimate[i], estimate[j])
    # |E's translation| = |p's - q's translation|, as both are expressed in the first pose's frame.
    return np.linalg.norm(p[:, :2] - q[:, :2], axis=1), wrapped(p[:, 2] - q[:, 2])
