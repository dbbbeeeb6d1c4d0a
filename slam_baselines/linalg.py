"""Small symmetric matrices, and arrays of planar poses (n, 3): x, y, yaw."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lirs_wct.geometry import FloatArray, Pose2, njit


@njit
def solve3(A: Any, b: Any) -> Any:
    """Solve a symmetric positive definite 3x3 system by Cramer's rule; zero where it is singular."""
    inverse = invert3(A)
    x = np.zeros(3)
    for i in range(3):
        for j in range(3):
            x[i] += inverse[i, j] * b[j]
    return x


@njit
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


@njit
def moved_covariance(P: Any, dx: float, dy: float, shift: float, turn: float) -> Any:
    """Return the covariance of x, y, yaw after a step (dx, dy) in the map frame.

    That is G P G' + Q with G = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]] and the step's own variances
    Q = diag(shift, shift, turn).
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


@njit
def compose(pose: Any, by: Any) -> Any:
    """Return pose @ by, all (3,)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array((pose[0] + c * by[0] - s * by[1], pose[1] + s * by[0] + c * by[1], pose[2] + by[2]))


@njit
def between(a: Any, b: Any) -> Any:
    """Return a^-1 @ b, all (3,)."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return np.array((c * dx + s * dy, c * dy - s * dx, b[2] - a[2]))


@njit
def pose_difference(pose: Any, other: Any) -> Any:
    """Return a pose (3,) less another, the heading in [-pi, pi)."""
    d = np.empty(3)
    for i in range(3):
        d[i] = pose[i] - other[i]
    d[2] = (d[2] + np.pi) % (2 * np.pi) - np.pi
    return d


def invert(matrices: FloatArray) -> FloatArray:
    """Return the inverses of (..., n, n) matrices."""
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)


def wrap(angle: FloatArray) -> FloatArray:
    """Return angles in [-pi, pi)."""
    wrapped: FloatArray = np.mod(angle + math.pi, math.tau) - math.pi
    return wrapped


def compose_poses(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return `T_a @ T_b` for each pair."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack((x, y, wrap(a[..., 2] + b[..., 2])), axis=-1)


def relative_poses(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return `T_a^-1 @ T_b` for each pair."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    return np.stack((c * dx + s * dy, -s * dx + c * dy, wrap(b[..., 2] - a[..., 2])), axis=-1)


def in_axes_of(frame: Pose2, matrix: FloatArray) -> FloatArray:
    """Rotate a covariance or information (3, 3) of a pose into a frame's axes."""
    c, s = math.cos(frame.yaw), math.sin(frame.yaw)
    R = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(R @ matrix @ R.T, dtype=np.float64)
