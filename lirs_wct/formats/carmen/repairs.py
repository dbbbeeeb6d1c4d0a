"""Rising stamps and the odometry of a CARMEN log.

A line is stamped when its message passes the log's network. Messages wait there and come in bursts, so the
stamps of real logs go back and repeat while the robot moves on. The order of the lines is right.

Wrong stamps are replaced by the nearest stamps, in the least squares' sense, that rise with the lines and
keep the log's usual speed limit between them. This is an isotonic regression (Barlow et al., Statistical
Inference under Order Restrictions, 1972) of the stamps less the least time between lines. A burst is thereby
spread over the gap around it. Stamps that already rise stay as logged.

The odometry is that of the laser's own messages, else that of ODOM lines, else none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.formats.carmen.lines import Message
from lirs_wct.formats.laser_log import LineStamps
from lirs_wct.geometry.pose import Pose2, Trajectory

LEAP = 10.0
"""Longest delay, seconds; a larger step back is a damaged line or a clock that was set."""
WINDOW = 20
"""Lines over which pace and speed are measured, so that delays average out."""
PERCENTILE, MARGIN = 99.0, 1.25
"""Speed limit between repaired lines: this percentile of the speed over windows, times the margin."""
LEAST_STEP = 1e-3
"""Seconds between repaired lines, at least."""
USUAL_STEP = 0.1
"""Seconds between the lines of a log whose stamps are all the same."""
SAME = 1e-6
"""Resolution of logged stamps (six decimals), seconds."""


def in_file_order(
    scans: Sequence[Message], odoms: Sequence[Message]
) -> tuple[list[Message], list[Message], LineStamps]:
    """Return the messages in file order with rising stamps.

    If a file holds one kind of message after the other, only the stamps order the two kinds.

    Args:
        scans: messages with a scan, at least one.
        odoms: messages without a scan.
    """
    lines = _lines(scans, odoms)
    holds_scan = np.array([len(m.ranges) > 0 for m in lines])
    logged = np.array([m.stamp for m in lines])
    distances = _motion(lines)
    repaired = logged if _sound(logged, holds_scan, distances) else _rising(logged, distances)
    moved = [
        m if m.stamp == stamp else replace(m, stamp=stamp)
        for m, stamp in zip(lines, repaired.tolist(), strict=True)
    ]
    return (
        [m for m in moved if len(m.ranges)],
        [m for m in moved if not len(m.ranges)],
        LineStamps(logged, repaired, holds_scan),
    )


def _lines(scans: Sequence[Message], odoms: Sequence[Message]) -> list[Message]:
    """Return the messages in file order.

    If the file holds one kind of message after the other, return them by stamp.
    """
    lines = sorted([*scans, *odoms], key=lambda m: m.line)
    if _steps(lines).min(initial=0) < -LEAP and min(_steps(k).min(initial=0) for k in (scans, odoms)) >= 0:
        return sorted(lines, key=lambda m: m.stamp)
    return lines


def _steps(lines: Sequence[Message]) -> FloatArray:
    """Return (n - 1,) seconds from line to line."""
    return np.diff(np.array([m.stamp for m in lines]))


def _motion(lines: Sequence[Message]) -> FloatArray:
    """Return (n - 1, 2) meters and radians from line to line.

    A line without a pose has that of the line before or after it, whichever is nearer in time. Constant poses
    of scans are ignored: the odometry is then in the other lines.
    """
    own = len({m.base for m in lines if len(m.ranges)}) > 1
    bases = [m.base if own or not len(m.ranges) else None for m in lines]
    posed = np.flatnonzero([base is not None for base in bases])
    if len(posed) == 0:
        return np.zeros((len(lines) - 1, 2))
    at, stamps = np.arange(len(lines)), np.array([m.stamp for m in lines])
    after = posed[np.minimum(np.searchsorted(posed, at), len(posed) - 1)]
    before = posed[np.maximum(np.searchsorted(posed, at, side="right") - 1, 0)]
    nearer = np.where(np.abs(stamps[after] - stamps) <= np.abs(stamps - stamps[before]), after, before)
    known = {k: bases[k] or Pose2() for k in posed.tolist()}
    steps = np.diff(np.array([known[k].as_array() for k in nearer.tolist()]), axis=0)
    turn = np.abs(np.remainder(steps[:, 2] + np.pi, 2 * np.pi) - np.pi)
    return np.column_stack((np.hypot(steps[:, 0], steps[:, 1]), turn))


def _sound(stamps: FloatArray, scans: BoolArray, distances: FloatArray) -> bool:
    """Whether stamps rise from scan to scan, and between lines of different poses."""
    steps = np.diff(stamps)
    moving = (distances > 0).any(axis=1)
    return bool((steps >= 0).all() and (steps[moving] > 0).all() and (np.diff(stamps[scans]) > 0).all())


def _rising(logged: FloatArray, distances: FloatArray) -> FloatArray:
    """Return (n,) rising stamps, unchanged where they are right."""
    from scipy.optimize import isotonic_regression  # imported here: sound logs do not need it

    start = float(np.median(logged))
    stamps = logged - start
    least = np.concatenate(((0.0,), np.cumsum(_least_steps(stamps, distances))))
    rising = isotonic_regression(stamps - least).x + least
    repaired: FloatArray = np.where(np.abs(rising + start - logged) < SAME, logged, rising + start)
    return repaired


def _least_steps(stamps: FloatArray, distances: FloatArray) -> FloatArray:
    """Return (n - 1,) the least time between lines at the log's speed limit, seconds."""
    n = min(WINDOW, len(stamps) - 1)
    span = stamps[n:] - stamps[:-n]
    pace = float(np.median(span)) / n
    pace = pace if pace > 0 else float(np.ptp(stamps)) / (len(stamps) - 1) or USUAL_STEP
    path = np.concatenate((np.zeros((1, 2)), np.cumsum(distances, axis=0)))
    # A window much shorter than most is a burst, which does not show the speed.
    speeds = (path[n:] - path[:-n]) / np.maximum(span, n * pace / 2)[:, None]
    limit = MARGIN * np.percentile(speeds, PERCENTILE, axis=0)
    takes = np.divide(distances, limit, out=np.zeros_like(distances), where=limit > 0).max(axis=1)
    least: FloatArray = np.clip(takes, LEAST_STEP, max(pace, LEAST_STEP))
    return least


AGREEMENT = 1.0
"""Largest median distance of two sources in the same frame, meters."""


def odometry_of(
    stamps: Sequence[float], lasers: Sequence[Message], odoms: Sequence[Message]
) -> tuple[list[Pose2 | None], Trajectory]:
    """Return `T_odom_base` of each scan, and the track of all odometry poses.

    Constant odometry counts as none, since the robot may have moved.

    Args:
        stamps: of the scans, increasing.
        lasers: the scans' messages.
        odoms: ODOM messages.
    """
    own, wheels = _track(lasers), _track(odoms)
    if _moves(own) or (len(lasers) == 1 and len(own)):
        return [m.base for m in lasers], _add_wheel_poses(own, wheels)
    if _moves(wheels):
        at = wheels.planar_at(np.asarray(stamps))
        return [Pose2(*row) for row in at.tolist()], wheels
    return [None] * len(stamps), Trajectory.from_poses([], [])


def _track(messages: Sequence[Message]) -> Trajectory:
    """Return the poses by stamp; of equal stamps, the later line's."""
    poses = {m.stamp: m.base for m in messages if m.base is not None}
    stamps = sorted(poses)
    return Trajectory.from_poses(stamps, [poses[t] for t in stamps])


def _moves(track: Trajectory) -> bool:
    if len(track) < 2:
        return False
    return bool(np.ptp(track.xy, axis=0).any() or np.ptp(track.quaternions, axis=0).any())


def _add_wheel_poses(own: Trajectory, wheels: Trajectory) -> Trajectory:
    """Add the poses of ODOM lines between scans if they share the scans' frame."""
    if len(wheels) == 0:
        return own
    far = np.linalg.norm(wheels.planar_at(own.stamps)[:, :2] - own.xy, axis=1)
    if len(own) > 1 and float(np.median(far)) > AGREEMENT:
        return own
    fresh = ~np.isin(wheels.stamps, own.stamps)
    stamps = np.concatenate((own.stamps, wheels.stamps[fresh]))
    order = np.argsort(stamps)
    return Trajectory(
        stamps[order],
        np.concatenate((own.positions, wheels.positions[fresh]))[order],
        np.concatenate((own.quaternions, wheels.quaternions[fresh]))[order],
    )
