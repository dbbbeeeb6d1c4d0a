"""Codes for no return among the readings of a laser."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from lirs_wct.geometry import FARTHEST, BoolArray, Float32Array

NO_RETURN = 50.0
"""Ranges from here on mean no return (50, 51.2, 81.83), read as +inf, meters."""
RANGE_MIN = 0.02
"""Shortest valid range, that of the SICK LMS's front pane; shorter ranges are errors, meters."""

CODE_SHARE, CODE_BEAMS, CODE_CONTRAST, MAX_CODE_RATIO = 0.001, 0.05, 20, 100
"""Conditions under which the largest range is a code: least share of all ranges, least share of the beams,
least ratio to the frequency of the three meters below it, and largest ratio to all other ranges."""


def no_return(ranges: Float32Array, farthest: float = NO_RETURN) -> float:
    """Return the smallest code for no return in readings (scans, beams), meters; `farthest` without one.

    Many sensors report their largest range. That value repeats often, in all directions, and similar values
    are rare. From `farthest` on, every reading is a code.
    """
    real = (ranges >= RANGE_MIN) & (ranges < farthest)
    cm = np.where(real, np.round(np.where(real, ranges, 0) * 100), 0).astype(np.int64)
    counts = np.bincount(cm.ravel(), minlength=2)
    counts[0] = 0
    limit = farthest
    while counts.any():
        top = int(np.flatnonzero(counts)[-1])
        below = counts[max(0, top - 300) : top]
        count, rest = int(counts[top]), int(counts[:top].sum())
        usual = CODE_CONTRAST * max(1.0, float(np.median(below)))
        if MAX_CODE_RATIO * rest < count or count < max(usual, CODE_SHARE * ranges.size):
            return limit
        if (cm == top).any(axis=0).sum() < CODE_BEAMS * ranges.shape[1]:
            return limit
        limit = (top - 0.5) / 100
        counts[top] = 0
    return limit


def usual_reading(ranges: Float32Array) -> float | None:
    """Return the most frequent finite reading to the millimeter, meters; None without one."""
    readings, counts = np.unique(
        np.round(ranges[np.isfinite(ranges)].astype(np.float64), 3), return_counts=True
    )
    return float(readings[np.argmax(counts)]) if len(readings) else None


SAMPLE_SCANS = 500
"""Scans of a laser, evenly spaced, in which codes for no return are searched."""
MIN_EXACT_SHARE, MIN_EXACT_BEAMS = 0.01, 0.2
"""Least share of the readings that are a code below the largest reading, and of the beams that show it."""
MAX_MEDIAN, LARGEST_PERCENTILE = 100.0, 99.95
"""Median reading that is no meters; percentile of the readings that is their largest, without outliers."""
RANGE_TOLERANCE, EXACT_CODE_SHARE = 0.0005, 0.9
"""Largest difference of two readings of one code, meters, and share of them among the readings from it on."""
NOISE_CENTIMETERS, MAX_DISTANCE_SHARE, MIN_DENSITY_RATIO, MIN_SCAN_SHARE = 5, 0.02, 5.0, 0.5
"""Noisy readings for no return: width in centimeters; distance from range_max as a share of it; ratio to the
readings in the meter below, and share of the scans, at least."""


class RangeDecoder:
    """Conversion of one laser's readings to REP 117: +inf = no return, NaN = invalid.

    Drivers report no return as range_max, with or without noise, as 0, or as another code.

    Attributes:
        farthest: Largest range, meters.
        codes: Readings that mean no return, and corrections, in words.
    """

    def __init__(
        self, ranges: Sequence[Float32Array], limits: tuple[float, float], range_max: float | None
    ) -> None:
        """Find the codes in the readings (n,) of each scan, meters.

        The limits are the shortest and largest range that the messages state. From `range_max` on, readings
        are no return.
        """
        size = Counter(len(r) for r in ranges).most_common(1)[0][0]
        usual = [r for r in ranges if len(r) == size]
        sample = np.stack(usual[:: -(-len(usual) // SAMPLE_SCANS)])
        real = sample[np.isfinite(sample) & (sample > 0)]
        far = real[np.abs(real - (usual_reading(real) or 0.0)) > RANGE_TOLERANCE]
        if far.size and np.median(far) > MAX_MEDIAN:
            unit = "millimeters" if far.max() > 10 * MAX_MEDIAN else "centimeters"
            raise ValueError(f"ranges up to {far.max():,.0f} m: {unit}? LaserScan has meters")
        far = far[far > FARTHEST]
        self.codes: list[str] = []
        self._codes = [(range_max, math.inf)] if range_max else []
        range_min, stated = limits
        legal = 0 < stated <= FARTHEST
        limit = range_max or self._find_codes(sample, stated if legal else FARTHEST, range_min)
        known = real[~self._means_none(real) & (real <= min(limit, FARTHEST))]
        largest = float(np.percentile(known, LARGEST_PERCENTILE)) if known.size else 0.0
        self.farthest = stated if legal else largest
        if not legal:
            self.codes.append(f"range_max is {stated:g} m: the largest reading is taken, {largest:.2f} m")
        if far.size:
            self.codes.append(f"readings beyond {FARTHEST:g} m are left out")
        if limit < (1 - MAX_DISTANCE_SHARE) * self.farthest:
            self.farthest = range_max or largest

    def decode(self, ranges: Float32Array) -> Float32Array:
        """Return (n,) ranges of a scan, meters."""
        none = self._means_none(ranges)
        ranges = np.where(none, np.float32(np.inf), ranges)
        return np.where((ranges > FARTHEST) & ~none, np.float32(np.nan), ranges)

    def _means_none(self, ranges: Float32Array) -> BoolArray:
        """Return whether each reading means no return."""
        none: BoolArray = ranges == np.inf
        for low, high in self._codes:
            none |= (ranges >= low) & (ranges <= high)
        return none

    def _find_codes(self, ranges: Float32Array, range_max: float, range_min: float) -> float:
        """Find the codes in readings (scans, beams); return the least above 0, else FARTHEST."""
        if _is_code(np.isinf(ranges)):  # the driver has a reading for no return
            return FARTHEST
        limit = no_return(ranges, FARTHEST)
        if limit == FARTHEST > range_max:
            limit = _noisy_maximum(ranges, range_max)
        if limit < FARTHEST:
            self._add_code(ranges, limit, FARTHEST)
        elif (exact := _exact_code(ranges)) is not None:
            self._add_code(ranges, exact - RANGE_TOLERANCE, exact + RANGE_TOLERANCE)
        if range_min <= 0 and _is_code(ranges == 0):
            self._add_code(ranges, 0.0, 0.0)
        if _is_code(np.isfinite(ranges) & (ranges > FARTHEST)):
            self._add_code(ranges, FARTHEST, float(np.finfo(np.float32).max))
        return limit

    def _add_code(self, ranges: Float32Array, low: float, high: float) -> None:
        """Add the most frequent reading between two as a code; with noise, all of them."""
        inside = ranges[(ranges >= low) & (ranges <= high)]
        code = usual_reading(inside) or 0.0
        exact = np.abs(inside - code) <= RANGE_TOLERANCE
        is_exact = exact.mean() >= EXACT_CODE_SHARE
        self._codes.append((code - RANGE_TOLERANCE, code + RANGE_TOLERANCE) if is_exact else (low, high))
        self.codes.append(f"{code:g} m is a no-return code")


def _is_code(readings: BoolArray) -> bool:
    """Whether readings (scans, beams) are frequent and come from many directions."""
    return bool(readings.mean() >= CODE_SHARE and readings.any(axis=0).mean() >= CODE_BEAMS)


def _exact_code(ranges: Float32Array) -> float | None:
    """Return a reading that comes from many directions, far more often than its neighbors; else None."""
    real = ranges[np.isfinite(ranges) & (ranges > 0) & (ranges <= FARTHEST)]
    code = usual_reading(real) or 0.0
    same = np.abs(ranges - code) <= RANGE_TOLERANCE
    near = np.bincount((np.abs(real[np.abs(real - code) < 0.5] - code) * 100).astype(np.int64), minlength=50)
    usual = max(1.0, float(np.median(near)))
    frequent = same.mean() >= MIN_EXACT_SHARE and same.any(axis=0).mean() >= MIN_EXACT_BEAMS
    return code if frequent and same.sum() >= CODE_CONTRAST * usual else None


def _noisy_maximum(ranges: Float32Array, range_max: float) -> float:
    """Return the least reading of most scans that is range_max with noise, meters; else FARTHEST."""
    width = max(NOISE_CENTIMETERS, round(100 * MAX_DISTANCE_SHARE * range_max))
    middle = round(100 * range_max)
    inside = (ranges > 0) & (ranges < range_max + width / 100)
    counts = np.bincount((ranges[inside] * 100).astype(np.int64), minlength=middle + width + 1)
    density = np.convolve(counts, np.ones(NOISE_CENTIMETERS), "same")
    first = max(0, middle - width)
    peak = first + int(np.argmax(density[first:]))
    usual = float(np.median(density[max(0, first - 100) : first])) if first else 0.0
    if density[peak] < MIN_DENSITY_RATIO * max(1.0, usual):
        return FARTHEST
    floor = usual + (density[peak] - usual) / 10
    low = peak
    while low > first and density[low - 1] > floor:
        low -= 1
    noisy = (ranges >= low / 100) & (ranges < range_max + width / 100)
    return low / 100 if _is_code(noisy) and noisy.any(axis=1).mean() >= MIN_SCAN_SHARE else FARTHEST
