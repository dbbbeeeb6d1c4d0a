"""Trajectories of another rate or another clock at the stamps of a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import correlate, correlation_lags
from scipy.spatial.transform import Rotation, Slerp

from lirs_wct import SourceError, Trajectory
from lirs_wct.arrays import FloatArray

SAME = 1e-3
"""Poses within this time of a scan are of the scan, seconds."""
GAP = 1.5
"""Largest distance of two poses between which a scan's pose is interpolated, in periods of the scans."""
STEP, WINDOW = 0.05, 0.5
"""Sampling of the motion, and time over which a speed and a turn are measured, seconds."""
OVERLAP = 0.5
"""Least share of the shorter trajectory that lies within the other."""
CLEAR = 0.5
"""Least correlation of the motions at the right offset."""


def interpolate_poses(trajectory: Trajectory, stamps: FloatArray) -> Trajectory:
    """Return the poses at the stamps of scans (n,).

    Stamps whose neighboring poses are too far apart are left out. A trajectory is returned as it is if all
    its poses have a scan, or most are too far apart.
    """
    most = GAP * float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    gaps = np.diff(trajectory.stamps)
    if not len(gaps) or np.median(gaps) > most or _have_scans(trajectory.stamps, stamps):
        return trajectory
    after = np.searchsorted(trajectory.stamps, stamps)
    inside = (after > 0) & (after < len(trajectory))
    known = stamps[inside][gaps[after[inside] - 1] <= most]
    if not len(known):
        return trajectory
    columns = [np.interp(known, trajectory.stamps, column) for column in trajectory.positions.T]
    turns = Slerp(trajectory.stamps, Rotation.from_quat(trajectory.quaternions, scalar_first=True))
    return Trajectory(known, np.column_stack(columns), turns(known).as_quat(scalar_first=True))


def _have_scans(poses: FloatArray, scans: FloatArray) -> bool:
    """Return whether every pose has the stamp of a scan."""
    near = np.clip(np.searchsorted(scans, poses), 1, len(scans) - 1)
    distance = np.minimum(np.abs(scans[near] - poses), np.abs(scans[near - 1] - poses))
    return bool((distance <= SAME).all())


def find_time_offset(truth: Trajectory, estimate: Trajectory) -> float:
    """Return the seconds that lead from the estimate's clock to that of the truth.

    Speed and turn rate do not depend on the frame. Their correlation finds the offset to a step, and the
    least squares of their differences refine it.

    Raises:
        SourceError: the motions do not agree at any offset.
    """
    start = float(truth.stamps[0] - estimate.stamps[0])
    true, found = (_motion(t, np.arange(*_span(t), STEP)) for t in (truth, estimate))
    if min(len(true), len(found)) < 2 or not (true.std(axis=0) > 0).all():
        raise SourceError("too short to find its time offset: give it in seconds")
    a, b = ((m - m.mean(axis=0)) / np.maximum(m.std(axis=0), 1e-9) for m in (true, found))
    lags = correlation_lags(len(a), len(b))
    common = correlate(np.ones(len(a)), np.ones(len(b)))
    total = sum(correlate(a[:, k], b[:, k]) for k in range(2)) / (2 * np.maximum(common, 1))
    total[common < OVERLAP * min(len(a), len(b))] = -1
    best = int(np.argmax(total))
    if total[best] < CLEAR:
        raise SourceError(
            "no time offset found: at the best one, its motion and the run's correlate by "
            f"{total[best]:.2f}, at least {CLEAR:g} is needed"
        )
    coarse = start + STEP * float(lags[best])
    near = replace(estimate, stamps=estimate.stamps + coarse)
    fine = minimize_scalar(
        lambda x: _difference(truth, near, x), bounds=(-2 * STEP, 2 * STEP), method="bounded"
    )
    return coarse + float(fine.x)


def _span(trajectory: Trajectory) -> tuple[float, float]:
    """Return first and last stamp at which the motion is known."""
    return float(trajectory.stamps[0]) + WINDOW / 2, float(trajectory.stamps[-1]) - WINDOW / 2


def _motion(trajectory: Trajectory, stamps: FloatArray) -> FloatArray:
    """Return (n, 2) distance and turn within a window around each stamp, meters and radians."""
    before, after = (trajectory.planar_at(stamps + shift) for shift in (-WINDOW / 2, WINDOW / 2))
    step = after - before
    return np.column_stack((np.hypot(step[:, 0], step[:, 1]), step[:, 2]))


def _difference(truth: Trajectory, estimate: Trajectory, offset: float) -> float:
    """Return the mean square of the motions' differences at an offset."""
    low, high = _span(truth)
    first, last = _span(estimate)
    stamps = np.arange(max(low, first + offset), min(high, last + offset), STEP / 2)
    difference = _motion(truth, stamps) - _motion(estimate, stamps - offset)
    return float(np.mean(difference**2))
