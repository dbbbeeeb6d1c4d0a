"""The alignment of a trajectory as an error of its start frame: by how much a whole map is off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lirs_validation.metrics.association import associated
from lirs_validation.metrics.planar import rigid_alignment
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory

SHORTEST = 1.0
"""Meters of path below which a trajectory does not say how it is turned."""


@dataclass(frozen=True, kw_only=True)
class StartAlignment:
    """The rigid motion that aligns an estimate with the truth, as it does for the ATE.

    Attributes:
        T_world_aligned: moves what the mapper placed in the world (path, map) to where it fits best.
        shift: how far it moves the start pose, meters.
        turn: by how much it turns, radians, not negative.
    """

    T_world_aligned: Pose2
    shift: float
    turn: float


def start_alignment(truth: Trajectory, estimate: Trajectory) -> StartAlignment | None:
    """Align an estimate with the truth; None where fewer than two poses or no meter of path is common.

    Args:
        truth: true poses in the world frame, from the start pose on.
        estimate: estimated poses in the world frame (moved by the true start pose).
    """
    i, j = associated(truth.stamps, estimate.stamps)
    if len(i) < 2 or np.linalg.norm(np.diff(truth.xy[i], axis=0), axis=1).sum() < SHORTEST:
        return None
    T = rigid_alignment(estimate.xy[j], truth.xy[i])
    start = truth.pose2(0)
    return StartAlignment(T_world_aligned=T, shift=(T @ start).distance(start), turn=abs(T.yaw))
