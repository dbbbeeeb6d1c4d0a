"""Poses of the plane by the array: x, y in meters, yaw in radians, one pose a row."""

from __future__ import annotations

import math

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory


def planar(trajectory: Trajectory) -> FloatArray:
    """Return (n, 3): x, y in meters, yaw in radians."""
    return np.column_stack((trajectory.xy, trajectory.yaw))


def moved(poses: FloatArray, T_new_frame: Pose2) -> FloatArray:
    """Return planar poses (n, 3) expressed in another frame."""
    return np.column_stack((T_new_frame.apply(poses[:, :2]), wrapped(poses[:, 2] + T_new_frame.yaw)))


def wrapped(angles: FloatArray) -> FloatArray:
    """Return angles in [-pi, pi]."""
    result: FloatArray = np.remainder(angles + math.pi, math.tau) - math.pi
    return result


def motion(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return (n, 3) the poses b expressed in the poses a."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    d = b[:, :2] - a[:, :2]
    return np.column_stack((c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], b[:, 2] - a[:, 2]))


def rigid_alignment(source: FloatArray, target: FloatArray) -> Pose2:
    """Return `T_target_source` that brings points (n, 2) nearest to points (n, 2) in the least-squares sense.

    The plane's closed form of Umeyama (PAMI 1991, Eqs. 39-42) without scale: with both sets centered,
    the best rotation has the angle of (sum of dot products, sum of cross products).
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    dot = float(np.sum(a * b))
    cross = float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    turn = Pose2(yaw=math.atan2(cross, dot) if dot or cross else 0.0)
    x, y = (target.mean(axis=0) - turn.apply(source.mean(axis=0))).tolist()
    return Pose2(x, y, turn.yaw)


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
