"""Failures of a path, and the alarms that report them: delay, misses, false alarms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lirs_wct import BoolArray, FloatArray
from slam_baselines.watch import LENGTH, MIN_LENGTH

SOON = 5.0
"""Seconds around a failure in which an alarm belongs to it."""


def window_errors(true: FloatArray, estimate: FloatArray, length: float = LENGTH) -> FloatArray:
    """Return (n,) the ATE over each pose's last `length` meters, meters.

    NaN over the first meter. Both paths are (n, 2 or more), x and y first. With p and q centered as complex
    numbers, it is sqrt(mean |p|² + mean |q|² - 2 |mean conj(p) q|) (Umeyama, PAMI 1991).
    """
    p, q = (path[:, 0] + 1j * path[:, 1] for path in (estimate, true))
    p, q = p - p.mean(), q - q.mean()  # small numbers are squared more exactly
    driven = np.append(0.0, np.cumsum(np.abs(np.diff(q))))
    first = np.maximum(0, np.searchsorted(driven, driven - length, side="right") - 1)
    end = np.arange(1, len(q) + 1)

    def means(values: Any) -> Any:
        sums = np.append(0.0, np.cumsum(values))
        return (sums[end] - sums[first]) / (end - first)

    centered = means(abs(p) ** 2 + abs(q) ** 2) - abs(means(p)) ** 2 - abs(means(q)) ** 2
    together = abs(means(p.conj() * q) - means(p).conj() * means(q))
    errors: FloatArray = np.sqrt(np.maximum(0.0, centered - 2 * together))
    errors[driven < MIN_LENGTH] = np.nan
    return errors


@dataclass(frozen=True, kw_only=True)
class Alarms:
    """Alarms of one source, compared with a failure.

    Attributes:
        noticed: Whether one was on within `SOON` of the onset; None without a failure.
        delay: Seconds from the onset to the first alarm, at the earliest `SOON` before it; None without.
        false: Number of alarms that began farther than `SOON` from any failing pose.
        healthy: Seconds of such times.
        false_per_hour: False alarms per hour of these; None of less than `SOON`.
    """

    noticed: bool | None
    delay: float | None
    false: int
    healthy: float
    false_per_hour: float | None


def compare_alarms(stamps: FloatArray, failing: BoolArray, alarm: BoolArray, onset: float | None) -> Alarms:
    """Compare alarms with the poses that fail.

    Args:
        stamps: (n,) of the poses, seconds.
        failing: (n,) whether the error over the last meters is too large.
        alarm: (n,) whether there was an alarm.
        onset: Stamp of the first failing pose of a path that is lost; None without a failure.
    """
    at = np.concatenate(([-np.inf], stamps[failing], [np.inf]))
    after = np.searchsorted(at, stamps)
    near = np.minimum(at[after] - stamps, stamps - at[after - 1]) <= SOON
    begun = alarm & ~np.append(False, alarm[:-1])
    false, healthy = int((begun & ~near).sum()), float((np.diff(stamps) * ~near[1:]).sum())
    delay = None
    if onset is not None and len(on := stamps[alarm & (stamps >= onset - SOON)]):
        delay = float(on[0]) - onset
    return Alarms(
        noticed=None if onset is None else delay is not None and delay <= SOON,
        delay=delay,
        false=false,
        healthy=healthy,
        false_per_hour=3600 * false / healthy if healthy >= SOON else None,
    )
