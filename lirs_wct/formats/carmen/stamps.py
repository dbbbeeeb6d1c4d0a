"""Stamps of a log's lines, made to rise in the order of the file.

A line is stamped when its message passes the log's network: messages wait there and come in bursts, so the
stamps of real logs go back and repeat while the robot moves on. The order of the lines is right. Stamps that
cannot be right are replaced by those nearest to them, in the least squares' sense, that rise with the lines
and between which the robot drives no faster than over many lines of the log: an isotonic regression (Barlow
et al., Statistical Inference under Order Restrictions, 1972) of the stamps less the least time between lines.
A burst is thereby spread over the gap around it. Stamps that rise as they should stay as logged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.formats.carmen.lines import Message
from lirs_wct.formats.laser_log import LineStamps
from lirs_wct.geometry.pose import Pose2

LEAP = 10.0
"""Stamps that go back by more are no delay: a damaged line, or a clock that was set, seconds."""
LOOK = 5
"""Lines after a leap among which the stamps may have come back."""
WINDOW = 20
"""Lines over which a log's pace and speed are measured: delays average out over so many."""
PERCENTILE, MARGIN = 99.0, 1.25
"""The speed limit of repaired lines: this percentile of the speed over windows, times the margin."""
LEAST_STEP = 1e-3
"""Seconds between repaired lines, at least."""
USUAL_STEP = 0.1
"""Seconds between the lines of a log whose stamps are all the same."""
SAME = 1e-6
"""Stamps are written with six decimals, seconds."""


def in_file_order(
    scans: Sequence[Message], odoms: Sequence[Message]
) -> tuple[list[Message], list[Message], LineStamps]:
    """Return the messages in the order of their lines with stamps that rise.

    A file that holds one kind of message after the other has no order between them but that of the stamps.

    Args:
        scans: messages with a scan, at least one.
        odoms: messages without.
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
    """Return the messages as the file has them; by stamp where each kind rises and they follow each other."""
    lines = sorted([*scans, *odoms], key=lambda m: m.line)
    if _steps(lines).min(initial=0) < -LEAP and min(_steps(k).min(initial=0) for k in (scans, odoms)) >= 0:
        return sorted(lines, key=lambda m: m.stamp)
    return lines


def _steps(lines: Sequence[Message]) -> FloatArray:
    """Return (n - 1,) seconds from line to line."""
    return np.diff(np.array([m.stamp for m in lines]))


def _motion(lines: Sequence[Message]) -> FloatArray:
    """Return (n - 1, 2) meters and radians from line to line.

    A line without a pose has that of the line before or after it, whichever is nearer in time. Poses of scans
    that never change are none: the odometry is in the other lines.
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
    """Return (n,) rising stamps; as logged where they are right."""
    from scipy.optimize import isotonic_regression  # here: logs that are right do not wait for it

    start = float(np.median(logged))
    stamps = _one_clock(logged - start)
    least = np.concatenate(((0.0,), np.cumsum(_least_steps(stamps, distances))))
    rising = isotonic_regression(stamps - least).x + least
    repaired: FloatArray = np.where(np.abs(rising + start - logged) < SAME, logged, rising + start)
    return repaired


def _least_steps(stamps: FloatArray, distances: FloatArray) -> FloatArray:
    """Return (n - 1,) the least time between lines, seconds: what the motion takes, but no pause."""
    n = min(WINDOW, len(stamps) - 1)
    span = stamps[n:] - stamps[:-n]
    pace = float(np.median(span)) / n
    pace = pace if pace > 0 else float(np.ptp(stamps)) / (len(stamps) - 1) or USUAL_STEP
    path = np.concatenate((np.zeros((1, 2)), np.cumsum(distances, axis=0)))
    # A window much shorter than most is a burst, which says nothing about the speed.
    speeds = (path[n:] - path[:-n]) / np.maximum(span, n * pace / 2)[:, None]
    limit = MARGIN * np.percentile(speeds, PERCENTILE, axis=0)
    takes = np.divide(distances, limit, out=np.zeros_like(distances), where=limit > 0).max(axis=1)
    least: FloatArray = np.clip(takes, LEAST_STEP, max(pace, LEAST_STEP))
    return least


def _one_clock(stamps: FloatArray) -> FloatArray:
    """Return stamps without leaps: a damaged one comes between its neighbors, a clock set back runs on."""
    if not (np.diff(stamps) < -LEAP).any():
        return stamps
    damaged, set_anew = _leaps(stamps)
    lines = np.arange(len(stamps))
    kept = np.setdiff1d(lines, damaged)
    bounds = [0, *set_anew, len(stamps)]
    usual = max(float(np.median(np.diff(stamps[kept]))), LEAST_STEP)
    parts: list[FloatArray] = []
    shifts: list[float] = []
    for first, end in pairwise(bounds):
        inside = kept[(kept >= first) & (kept < end)]
        shift = float(parts[-1][-1] + usual - stamps[inside[0]]) if parts else 0.0
        parts.append(stamps[inside] + shift)
        shifts.append(shift)
    longest = int(np.argmax([len(part) for part in parts]))
    return np.interp(lines, kept, np.concatenate(parts) - shifts[longest])


def _leaps(stamps: FloatArray) -> tuple[list[int], list[int]]:
    """Return which lines have stamps far from those before and after, and at which a clock was set back."""
    damaged: list[int] = []
    set_anew: list[int] = []
    last = 0
    for k in range(1, len(stamps)):
        following = stamps[k + 1 : k + 1 + LOOK]
        on = following >= stamps[last] - LEAP
        if stamps[k] < stamps[last] - LEAP:
            if on.any():
                damaged.append(k)
                continue
            set_anew.append(k)
        elif stamps[k] > stamps[last] + LEAP and (on & (following < stamps[k] - LEAP)).any():
            damaged.append(k)
            continue
        last = k
    return damaged, set_anew
