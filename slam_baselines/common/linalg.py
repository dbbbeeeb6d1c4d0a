"""Small matrices: kernels for symmetric 3x3 ones, since NumPy's calls cost more than their arithmetic."""

from __future__ import annotations

from typing import Any

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.kernels import njit


@njit(cache=True, nogil=True)
def solve3(A: Any, b: Any) -> Any:
    """Solve a symmetric positive definite 3x3 system by Cramer's rule; zero where it is singular."""
    inverse = invert3(A)
    x = np.zeros(3)
    for i in range(3):
        for j in range(3):
            x[i] += inverse[i, j] * b[j]
    return x


@njit(cache=True, nogil=True)
def invert3(A: Any) -> Any:
    """Return the inverse of a symmetric positive definite matrix; zeros where it is singular."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c01 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c02 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    B = np.zeros((3, 3))
    if not det > 0:
        return B
    B[0, 0], B[1, 1] = c00 / det, (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]) / det
    B[2, 2] = (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]) / det
    B[0, 1] = B[1, 0] = c01 / det
    B[0, 2] = B[2, 0] = c02 / det
    B[1, 2] = B[2, 1] = (A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1]) / det
    return B


@njit(cache=True, nogil=True)
def moved_covariance(P: Any, dx: float, dy: float, shift: float, turn: float) -> Any:
    """Return the covariance of x, y, yaw after a step of (dx, dy) in the map frame with its own variances.

    That is G P G' + Q with G = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]] and Q = diag(shift, shift, turn).
    """
    a, b, c = P[0, 2], P[1, 2], P[2, 2]
    R = np.empty((3, 3))
    R[0, 0] = P[0, 0] - 2 * dy * a + dy * dy * c + shift
    R[1, 1] = P[1, 1] + 2 * dx * b + dx * dx * c + shift
    R[0, 1] = R[1, 0] = P[0, 1] + dx * a - dy * b - dx * dy * c
    R[0, 2] = R[2, 0] = a - dy * c
    R[1, 2] = R[2, 1] = b + dx * c
    R[2, 2] = c + turn
    return R


def inverted(matrices: FloatArray) -> FloatArray:
    """Return the inverses of (..., n, n) matrices."""
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)
