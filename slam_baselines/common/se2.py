"""Many planar poses at once, as (n, 3) arrays of x, y, yaw."""

from __future__ import annotations

import math

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.pose import Pose2


def wrap(angle: FloatArray) -> FloatArray:
    """Return angles in [-pi, pi)."""
    wrapped: FloatArray = np.mod(angle + math.pi, math.tau) - math.pi
    return wrapped


def composed(a: FloatArray, b: FloatArray) -> FloatArray:
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
    """Return a covariance or information (3, 3) of x, y, yaw in the axes of a frame turned by its yaw."""
    c, s = math.cos(frame.yaw), math.sin(frame.yaw)
    R = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(R @ matrix @ R.T, dtype=np.float64)
