"""Odometry errors of a robot from its log.

They are the scale of distances, and white noise and bias of the turn rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_envs.robot_model import CONTROL_PERIOD
from lirs_wct.arrays import FloatArray, IntArray

SEGMENT = 5.0
"""Length of the pieces of path whose distance and turn are compared, meters."""
STEP = 0.5
"""Length of the chords that add up to a segment: short ones would count the noise of the poses."""
OUTLIER = 4.0
"""Largest deviation of a segment from the median, in deviations of the central 68 %."""
SEGMENTS = 5
"""Fewest segments of a fit."""
SAMPLES = 500
"""Bootstrap samples of the segments."""


@dataclass(frozen=True)
class FittedOdometry:
    """Odometry errors with 95 % confidence intervals.

    Attributes:
        segments: count of segments.
        scale: systematic part of the distance's scale error, which presets do not have.
        scale_sigma: deviation of the scale error, and interval.
        rate_sigma: white noise of the turn rate in each update of a simulation, rad/s, and interval.
        rate_bias: absolute mean error of the turn rate, rad/s.
    """

    segments: int
    scale: float
    scale_sigma: tuple[float, float, float]
    rate_sigma: tuple[float, float, float]
    rate_bias: float


def fit_odometry(
    odometry: FloatArray,
    poses: FloatArray,
    stamps: FloatArray,
    control: FloatArray,
    scale_length: float,
    seed: int,
) -> FittedOdometry | None:
    """Fit the errors of odometry by matched poses.

    Args:
        odometry: (n, 3) poses of the laser by odometry, in any frame.
        poses: (n, 3) matched poses.
        stamps: (n,) seconds.
        control: (n, 3) matched poses of a simulation whose truth is `poses`; their errors are subtracted.
        scale_length: correlation length of the scale error, meters.
        seed: of the bootstrap.

    Returns:
        None if the path has too few segments.
    """
    keys, ends = _segments(poses)
    if len(ends) <= SEGMENTS:
        return None
    times = np.diff(stamps[keys][ends])
    found = np.column_stack((*_errors(odometry[keys], poses[keys], ends), times))
    matching = np.column_stack((*_errors(control[keys], poses[keys], ends), times))
    ratio = SEGMENT / scale_length
    # Variance of the mean of a first-order Gauss-Markov process over a segment.
    mean = 2 * (ratio - 1 + math.exp(-ratio)) / ratio**2
    rng = np.random.default_rng(seed)
    n = len(found)
    draws = [np.arange(n), *(rng.integers(n, size=n) for _ in range(SAMPLES))]
    fits = np.array([_spread(found[k], matching[k], mean) for k in draws])
    low, high = np.quantile(fits[1:], (0.025, 0.975), axis=0)
    scale, rate = ((float(fits[0, k]), float(low[k]), float(high[k])) for k in range(2))
    bias = abs(float(found[:, 1].sum() / times.sum()))
    return FittedOdometry(n, float(np.median(found[:, 0])), scale, rate, bias)


def _segments(poses: FloatArray) -> tuple[IntArray, IntArray]:
    """Return poses at least a step apart, and those of them at which segments end."""
    keys, ends, along = [0], [0], 0.0
    for k in range(1, len(poses)):
        step = math.hypot(*(poses[k, :2] - poses[keys[-1], :2]).tolist())
        if step >= STEP:
            keys.append(k)
            along += step
            if along >= SEGMENT:
                ends.append(len(keys) - 1)
                along = 0.0
    return np.array(keys), np.array(ends)


def _errors(estimate: FloatArray, truth: FloatArray, ends: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return relative errors of the distance and errors of the turn, radians, of each segment."""
    lengths = []
    for path in (estimate, truth):
        chords = np.hypot(*np.diff(path[:, :2], axis=0).T)
        lengths.append(np.diff(np.concatenate(([0.0], np.cumsum(chords)))[ends]))
    turns = [np.diff(path[ends, 2]) for path in (estimate, truth)]
    error = turns[0] - turns[1]
    return lengths[0] / lengths[1] - 1, (error + np.pi) % (2 * np.pi) - np.pi


def _spread(found: FloatArray, matching: FloatArray, mean: float) -> tuple[float, float]:
    """Return the deviations of scale and turn rate without those of the matching.

    Args:
        found: (n, 3) errors of distance and turn, and seconds, of each segment.
        matching: (n, 3) the same of the matched poses.
        mean: variance of a segment's mean scale error over that of the scale error.
    """
    scale = max(_variance(found[:, 0]) - _variance(matching[:, 0]), 0.0) / mean
    rates = []
    for errors in (found, matching):
        turn, seconds = errors[:, 1], errors[:, 2]
        drift = turn - turn.sum() / seconds.sum() * seconds
        rates.append(_variance(drift / np.sqrt(CONTROL_PERIOD * seconds)))
    return math.sqrt(scale), math.sqrt(max(rates[0] - rates[1], 0.0))


def _variance(values: FloatArray) -> float:
    """Return the variance, with outliers moved to four deviations from the median."""
    low, middle, high = np.quantile(values, (0.1587, 0.5, 0.8413)).tolist()
    reach = OUTLIER * (high - low) / 2
    return float(np.var(np.clip(values, middle - reach, middle + reach), ddof=1))
