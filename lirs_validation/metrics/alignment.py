"""Trajectory alignment: association by time, rigid alignment, offset of the start frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.geometry import Pose2, Trajectory

SHORTEST = 1.0
"""Meters of path below which a trajectory does not say how it is turned."""


@dataclass(frozen=True, kw_only=True)
class StartAlignment:
    """Rigid motion that aligns an estimate with the truth, as for the ATE.

    Attributes:
        T_world_aligned: moves the mapper's path and map, in the world frame, to the best fit.
        shift: how far it moves the start pose, meters.
        turn: by how much it turns, radians, not negative.
    """

    T_world_aligned: Pose2
    shift: float
    turn: float


def start_alignment(truth: Trajectory, estimate: Trajectory) -> StartAlignment | None:
    """Align an estimate with the truth; None without two poses and a meter in common.

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


MAX_GAP = 0.02
"""Poses whose stamps differ by more than this (seconds) are not the same moment."""


def associated(
    first: FloatArray, second: FloatArray, *, max_gap: float = MAX_GAP
) -> tuple[IntArray, IntArray]:
    """Pair each stamp of the shorter list with the nearest of the longer.

    Pairs are at most `max_gap` apart.

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
    near = nearest(second, first)
    kept = np.flatnonzero(np.abs(second[near] - first) <= max_gap)
    return kept.astype(np.int64), near[kept]


def nearest(stamps: FloatArray, wanted: FloatArray) -> IntArray:
    """Return (n,) indices of the nearest increasing stamps (m,), of two the earlier."""
    after = np.minimum(np.searchsorted(stamps, wanted), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(wanted - stamps[before] <= stamps[after] - wanted, before, after).astype(np.int64)


def scan_coverage(scans: FloatArray, poses: FloatArray) -> float:
    """Return the share of scans with a pose at their stamp; 0 of no scans.

    A pose is at a scan's stamp where it is at most 0.02 s away, and nearer than half the scans' period: poses
    of every second scan cover half of them, however fast they follow each other.

    Args:
        scans: (n,) stamps of the scans, seconds, increasing.
        poses: (m,) stamps of the poses, seconds, increasing.
    """
    if len(scans) == 0 or len(poses) == 0:
        return 0.0
    steps = np.diff(scans)
    steps = steps[steps > 0]
    gap = min(MAX_GAP, 0.49 * float(np.median(steps))) if len(steps) else MAX_GAP
    return float((np.abs(poses[nearest(poses, scans)] - scans) <= gap).mean())


def planar(trajectory: Trajectory) -> FloatArray:
    """Return (n, 3): x, y in meters, yaw in radians."""
    return np.column_stack((trajectory.xy, trajectory.yaw))


def move_poses(poses: FloatArray, T_new_frame: Pose2) -> FloatArray:
    """Return planar poses (n, 3) expressed in another frame."""
    return np.column_stack((T_new_frame.apply(poses[:, :2]), wrap_angles(poses[:, 2] + T_new_frame.yaw)))


def wrap_angles(angles: FloatArray) -> FloatArray:
    """Return angles in [-pi, pi]."""
    result: FloatArray = np.remainder(angles + math.pi, math.tau) - math.pi
    return result


def motion(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return (n, 3) the poses b expressed in the poses a."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    d = b[:, :2] - a[:, :2]
    return np.column_stack((c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], b[:, 2] - a[:, 2]))


def rigid_alignment(source: FloatArray, target: FloatArray) -> Pose2:
    """Return the least-squares `T_target_source` from points (n, 2) to points (n, 2).

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
