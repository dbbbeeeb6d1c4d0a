"""Failures of a path, and the alarms that report them: delay, misses, false alarms."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lirs_validation.metrics.trajectory import MIN_PATH
from lirs_wct import BoolArray, FloatArray

LENGTH = 5.0
"""Path over which a failure is looked for, meters."""
SOON = 5.0
"""Seconds around a failure in which an alarm belongs to it."""
HOUR = 3600.0


def window_errors(true: FloatArray, estimate: FloatArray, length: float = LENGTH) -> FloatArray:
    """Return (n,) the ATE of each pose's last `length` meters, meters; NaN over the first meter.

    Both paths are (n, 2 or more), x and y first. As complex numbers about their means, the ATE after rigid
    alignment is sqrt(mean |p|² + mean |q|² - 2 |mean conj(p) q|) (Umeyama, PAMI 1991).
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
    errors[driven < MIN_PATH] = np.nan
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
    near = _near(stamps, failing)
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
        false_per_hour=HOUR * false / healthy if healthy >= SOON else None,
    )


def _near(stamps: FloatArray, failing: BoolArray) -> BoolArray:
    """Return (n,) whether each stamp is within `SOON` of a failing pose."""
    at = np.append(np.append(-np.inf, stamps[failing]), np.inf)
    after = np.searchsorted(at, stamps)
    gap = np.minimum(np.minimum(at[after] - stamps, np.inf), stamps - at[after - 1])
    return np.asarray(gap <= SOON)


def describe_failure(
    stamps: FloatArray, failing: BoolArray, alarms: dict[str, BoolArray], *, lost: bool
) -> dict[str, Any]:
    """Return onset and alarms as a record holds them.

    The onset is None if the whole path is not lost, and if no part of it fails.
    """
    onset = float(stamps[failing.argmax()]) if lost and failing.any() else None
    found = {name: asdict(compare_alarms(stamps, failing, alarm, onset)) for name, alarm in alarms.items()}
    return {"onset": onset} | found
