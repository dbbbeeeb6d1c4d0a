"""Constraints of the pose graph as arrays, their errors and the derivatives of these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_baselines.pose_arrays import relative_poses, wrap

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Edges:
    """Constraints as arrays.

    Attributes:
        a: (m,) index of the submap in whose frame it was measured.
        b: (m,) index of the node, or of another submap.
        z: (m, 3) measured x, y, yaw of b in the frame of a.
        information: (m, 3, 3) inverse covariance of z.
        robust: (m,) whether it may be wrong altogether.
    """

    a: Indices
    b: Indices
    z: Array
    information: Array
    robust: NDArray[np.bool_]

    @staticmethod
    def of(rows: Sequence[tuple[int, int, Array, Array, bool]]) -> Edges:
        """Stack (a, b, z, information, robust) of each constraint."""
        return Edges(
            np.array([r[0] for r in rows], dtype=np.int64),
            np.array([r[1] for r in rows], dtype=np.int64),
            np.array([r[2] for r in rows], dtype=np.float64).reshape(-1, 3),
            np.array([r[3] for r in rows], dtype=np.float64).reshape(-1, 3, 3),
            np.array([r[4] for r in rows], dtype=np.bool_),
        )


def errors(a: Array, b: Array, z: Array) -> Array:
    """Return (m, 3) the estimated minus the measured pose of b in the frame of a (eq. 6)."""
    e = relative_poses(a, b) - z
    e[:, 2] = wrap(e[:, 2])
    return e


def jacobians(a: Array, b: Array) -> tuple[Array, Array]:
    """Return (m, 3, 3) the derivatives of the errors with respect to a and to b."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    Jb = np.zeros((len(a), 3, 3))
    Jb[:, 0, 0], Jb[:, 0, 1], Jb[:, 1, 0], Jb[:, 1, 1], Jb[:, 2, 2] = c, s, -s, c, 1
    Ja = -Jb
    Ja[:, 0, 2], Ja[:, 1, 2] = c * dy - s * dx, -s * dy - c * dx
    return Ja, Jb
