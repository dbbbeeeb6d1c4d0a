"""Alignment of trajectories: association by time, offsets of clocks, rigid motions of frames."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy  # its modules load on first use
from scipy.spatial.transform import Rotation, Slerp

from lirs_wct import FloatArray, IntArray, Pose2, Pose3, SourceError, Trajectory

MAX_GAP = 0.02
"""Poses whose stamps differ by more than this (seconds) are not the same moment."""
SAME_STAMP = 1e-3
"""Poses within this time of a scan are of the scan, seconds."""
GAP_PERIODS, KEYFRAME_GAP = 1.5, 2.0
"""Largest distance of two poses between which a scan's pose is interpolated, in periods of the scans, or
seconds if that is more."""
STEP, WINDOW = 0.05, 0.5
"""Sampling of the motion, and time over which a speed and a turn are measured, seconds."""
MIN_OVERLAP, MIN_COMMON, MAX_SPAN = 0.5, 3.0, 1e5
"""Least share of the shorter trajectory within the other; least common and longest time, seconds."""
MIN_CORRELATION, EQUAL_CORRELATION = 0.5, 0.02
"""Least correlation of the motions at the right offset, and a difference that does not tell offsets apart."""
MIN_PATH = 1.0
"""Meters of path below which a trajectory does not say how it is turned."""
UPRIGHT_PART, MIN_SPREAD = math.cos(math.radians(45)), 0.05
"""Least vertical part of an upright z axis, and least ratio of a path's width to its length by which a fit in
space finds the axes."""


@dataclass(frozen=True, kw_only=True)
class StartAlignment:
    """Rigid motion that aligns an estimate with the truth, as for the ATE.

    Attributes:
        T_world_aligned: Motion of the mapper's path and map, in the world frame, to the best fit.
        shift: Distance by which it moves the start pose, meters.
        turn: Angle by which it turns, radians, not negative.
    """

    T_world_aligned: Pose2
    shift: float
    turn: float


def start_alignment(truth: Trajectory, estimate: Trajectory) -> StartAlignment | None:
    """Align an estimate with the truth; None without two poses and a meter in common.

    Args:
        truth: True poses in the world frame, from the start pose on.
        estimate: Estimated poses in the world frame (moved by the true start pose).
    """
    i, j = associated(truth.stamps, estimate.stamps)
    if len(i) < 2 or np.linalg.norm(np.diff(truth.xy[i], axis=0), axis=1).sum() < MIN_PATH:
        return None
    T = rigid_alignment(estimate.xy[j], truth.xy[i])
    start = truth.pose2(0)
    return StartAlignment(T_world_aligned=T, shift=(T @ start).distance(start), turn=abs(T.yaw))


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


def interpolate_poses(trajectory: Trajectory, stamps: FloatArray) -> Trajectory:
    """Return the poses at the stamps of scans (n,).

    Stamps whose neighboring poses are too far apart are left out. A trajectory is returned as it is if all
    scans have a pose, or most poses are too far apart.
    """
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    most, gaps = max(GAP_PERIODS * period, KEYFRAME_GAP), np.diff(trajectory.stamps)
    own = np.abs(trajectory.stamps[nearest(trajectory.stamps, stamps)] - stamps) <= SAME_STAMP
    if not len(gaps) or np.median(gaps) > most or own.all():
        return trajectory
    after = np.clip(np.searchsorted(trajectory.stamps, stamps), 1, len(gaps))
    inside = (stamps >= trajectory.stamps[0]) & (stamps <= trajectory.stamps[-1])
    known = stamps[inside & (own | (gaps[after - 1] <= most))]
    if not len(known):
        return trajectory
    positions, turns = _poses_at(trajectory, known)
    return Trajectory(known, positions, turns.as_quat(scalar_first=True))


def find_time_offset(truth: Trajectory, estimate: Trajectory) -> float:
    """Return the seconds that lead from the estimate's clock to that of the truth.

    Speed and turn rate do not depend on the frame. Their correlation finds the offset to a step, and the
    least squares of their differences refine it.

    Raises:
        SourceError: the motions do not agree at any offset.
    """
    span = float(np.ptp(estimate.stamps))
    if span > MAX_SPAN:
        raise SourceError(f"its stamps span {span:.4g} s, which has no time offset: give it in seconds")
    start = float(truth.stamps[0] - estimate.stamps[0])
    true, found = (_motion(t, np.arange(*_span(t), STEP)) for t in (truth, estimate))
    if min(len(true), len(found)) * STEP < MIN_COMMON or not (true.std(axis=0) > 0).all():
        raise SourceError("too short to find its time offset: give it in seconds")
    a, b = ((m - m.mean(axis=0)) / np.maximum(m.std(axis=0), 1e-9) for m in (true, found))
    lags = scipy.signal.correlation_lags(len(a), len(b))
    common = scipy.signal.correlate(np.ones(len(a)), np.ones(len(b)))
    total = sum(scipy.signal.correlate(a[:, k], b[:, k]) for k in range(2)) / (2 * np.maximum(common, 1))
    total[common < max(MIN_OVERLAP * min(len(a), len(b)), MIN_COMMON / STEP)] = -1
    equal = np.flatnonzero(total > total.max() - EQUAL_CORRELATION)
    equal = equal[common[equal] >= common[equal].max() - 1]
    if np.ptp(equal) * STEP > 2 * WINDOW:
        found_at = ", ".join(f"{start + STEP * float(lags[k]):.1f}" for k in (equal[0], equal[-1]))
        raise SourceError(
            f"its motion fits the run's at several time offsets, {found_at} s: give it in seconds"
        )
    best = int(equal[np.argmax(total[equal])])
    if total[best] < MIN_CORRELATION:
        raise SourceError(
            "no time offset found: at the best one, its motion and the run's correlate by "
            f"{total[best]:.2f}, at least {MIN_CORRELATION:g} is needed"
        )
    coarse = start + STEP * float(lags[best])
    near = replace(estimate, stamps=estimate.stamps + coarse)
    fine = scipy.optimize.minimize_scalar(
        lambda x: _difference(truth, near, x), bounds=(-2 * STEP, 2 * STEP), method="bounded"
    )
    return coarse + float(fine.x)


def _span(trajectory: Trajectory) -> tuple[float, float]:
    """Return first and last stamp at which the motion is known."""
    return float(trajectory.stamps[0]) + WINDOW / 2, float(trajectory.stamps[-1]) - WINDOW / 2


def _motion(trajectory: Trajectory, stamps: FloatArray) -> FloatArray:
    """Return (n, 2) distance and angle within a window around each stamp, meters and radians.

    Both are the same in any frame, also in that of a camera.
    """
    if len(trajectory) < 2:
        return np.empty((0, 2))
    ends = [np.clip(stamps + shift, *trajectory.stamps[[0, -1]]) for shift in (-WINDOW / 2, WINDOW / 2)]
    (before, turn), (after, turned) = (_poses_at(trajectory, t) for t in ends)
    return np.column_stack((np.linalg.norm(after - before, axis=1), (turn.inv() * turned).magnitude()))


def _poses_at(trajectory: Trajectory, stamps: FloatArray) -> tuple[FloatArray, Rotation]:
    """Return positions (n, 3) and attitudes, interpolated at stamps (n,) within the trajectory."""
    positions = [np.interp(stamps, trajectory.stamps, column) for column in trajectory.positions.T]
    turns = Slerp(trajectory.stamps, Rotation.from_quat(trajectory.quaternions, scalar_first=True))
    return np.column_stack(positions), turns(stamps)


def _difference(truth: Trajectory, estimate: Trajectory, offset: float) -> float:
    """Return the mean square of the motions' differences at an offset."""
    low, high = _span(truth)
    first, last = _span(estimate)
    stamps = np.arange(max(low, first + offset), min(high, last + offset), STEP / 2)
    difference = _motion(truth, stamps) - _motion(estimate, stamps - offset)
    return float(np.mean(difference**2))


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


def spatial_alignment(source: FloatArray, target: FloatArray) -> Pose3:
    """Return the least-squares `T_target_source` from points (n, 3) to points (n, 3).

    Umeyama (PAMI 1991), Eqs. 39-42 without scale. Points on a line leave the turn about it open; that of the
    singular value decomposition is then taken.
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    mirrored = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R = U @ np.diag((1.0, 1.0, mirrored)) @ Vt
    t = target.mean(axis=0) - R @ source.mean(axis=0)
    return Pose3.from_arrays(t, Rotation.from_matrix(R).as_quat(scalar_first=True))


def turn_upright(estimate: Trajectory, truth: Trajectory) -> tuple[Trajectory, str] | None:
    """Return an estimate turned to z up, and its axes; None if it is upright.

    The axes follow from the best fit in space, which a straight path does not have. Those of the body count
    as named like those of the frame, as in the trajectories of cameras.
    """
    i, j = associated(truth.stamps, estimate.stamps)
    true, found = (t.positions[k] - t.positions[k].mean(axis=0) for t, k in ((truth, i), (estimate, j)))
    spread = np.linalg.svd(found, compute_uv=False)
    width = np.ptp(found, axis=0)
    if len(i) < 3 or spread[1] < MIN_SPREAD * spread[0] or width[2] < MIN_SPREAD * width[:2].min():
        return None
    turn, _ = Rotation.align_vectors(true, found)
    up = turn.inv().apply((0.0, 0.0, 1.0))
    if up[2] > UPRIGHT_PART:
        return None
    z, heading = _main_axis(up), truth.pose2(int(i[0])).yaw
    x = _main_axis((1 - np.abs(z)) * turn.inv().apply((math.cos(heading), math.sin(heading), 0.0)))
    names = [f"{'-' if axis.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(axis)))]}" for axis in (x, z)]
    body = Rotation.from_matrix(np.column_stack((x, np.cross(z, x), z)))
    turned = turn * Rotation.from_quat(estimate.quaternions, scalar_first=True) * body
    upright = Trajectory(estimate.stamps, turn.apply(estimate.positions), turned.as_quat(scalar_first=True))
    return upright, f"{names[0]} ahead, {names[1]} up"


def _main_axis(direction: FloatArray) -> FloatArray:
    """Return the coordinate axis nearest to a direction (3,), with its sign."""
    axis = np.zeros(3)
    k = int(np.argmax(np.abs(direction)))
    axis[k] = np.sign(direction[k])
    return axis


def rms(values: FloatArray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
