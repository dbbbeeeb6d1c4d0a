"""Noise of lidar and odometry, fitted to a log.

The lidar's simulated residuals become as wide as the log's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import nnls
from scipy.stats import ks_2samp

from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.robot_model import CONTROL_PERIOD
from lirs_extensions.search.twin.surface import LogComparison, compare, simulate_scans
from lirs_wct import FloatArray, IntArray, SourceError

BINS = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, np.inf)
"""Bounds of the ranges whose residuals are counted together, meters."""
MIN_RESIDUALS = 200
"""Fewest residuals of a bin."""
ROUNDS = 3
"""Simulations of the log with the noise fitted so far."""
LEAST_SCANS, STRIDE = 1000, 1000
"""Fewest simulated scans of a comparison: chance then decides little; and step of their seeds."""
SAMPLES = 200
"""Bootstrap samples of the log's blocks, and of the segments."""
JUMP, EDGE_DISTANCE = 0.6, 0.15
"""Least difference between two neighbors at an edge, and distance of a mixed pixel from both, meters."""
SEGMENT = 5.0
"""Length of the pieces of path whose distance and turn are compared, meters."""
STEP = 0.5
"""Length of the chords that add up to a segment: short ones would count the noise of the poses."""
OUTLIER = 4.0
"""Largest deviation of a segment from the median, in deviations of the central 68 %."""
SEGMENTS = 5
"""Fewest segments of a fit."""
FLOOR = 1e-4
"""Smallest width of a bin's noise, meters."""
FITTED = ("sigma", "sigma_relative", "dropout", "mixed_pixels")
"""Fields of the noise that are fitted."""


@dataclass(frozen=True)
class Sample:
    """Statistics of a comparison, block by block.

    Attributes:
        residual: (m,) of the beams that count as noise, sorted by block, meters.
        ranges: (m,) their expected ranges, meters.
        first: (blocks + 1,) first of them in each block.
        counts: (blocks, 4) beams compared, beams lost, mixed pixels, and beams at edges.
    """

    residual: FloatArray
    ranges: FloatArray
    first: IntArray
    counts: FloatArray

    @classmethod
    def of(cls, *comparisons: LogComparison) -> Sample:
        """Return the statistics of comparisons of one log's blocks."""
        blocks = int(comparisons[0].scans.block.max()) + 1
        counts = np.zeros((blocks, 4))
        for comparison in comparisons:
            lost = comparison.compared & ~np.isfinite(comparison.residual)
            mixed, edges = _mixed_pixels(comparison)
            for column, values in enumerate((comparison.compared, lost, mixed, edges)):
                np.add.at(counts[:, column], comparison.scans.block, values.sum(axis=1))
        found = [comparison.residuals() for comparison in comparisons]
        residual, ranges, block = (np.concatenate(column) for column in zip(*found, strict=True))
        order = np.argsort(block, kind="stable")
        first = np.searchsorted(block[order], np.arange(blocks + 1))
        return cls(residual[order], ranges[order], first, counts)

    @property
    def blocks(self) -> IntArray:
        """(n,) blocks with compared beams."""
        return np.flatnonzero(self.counts[:, 0])

    def widths(self, blocks: IntArray) -> FloatArray:
        """Return (bins,) half the central 68 % of residuals, meters; NaN of too few."""
        some = np.concatenate([np.arange(self.first[b], self.first[b + 1]) for b in blocks])
        residual, bins = self.residual[some], np.digitize(self.ranges[some], BINS) - 1
        widths = np.full(len(BINS) - 1, np.nan)
        for k in range(len(widths)):
            found = residual[bins == k]
            if len(found) >= MIN_RESIDUALS:
                widths[k] = (np.quantile(found, 0.8413) - np.quantile(found, 0.1587)) / 2
        return widths

    def shares(self, blocks: IntArray) -> FloatArray:
        """Return the shares of lost beams, and of mixed pixels at edges."""
        compared, lost, mixed, edges = self.counts[blocks].sum(axis=0)
        return np.array((lost / max(compared, 1.0), mixed / max(edges, 1.0)))


def _mixed_pixels(comparison: LogComparison) -> tuple[FloatArray, FloatArray]:
    """Return (n, beams) mixed pixels near the beams at edges, and weights of the edges.

    A mixed pixel measures between the two sides of an edge. The map's edge may lie a beam away from the true
    one. An edge's weight is the part of its depth in which a mixed pixel is recognized.
    """
    ranges, measured = comparison.beams.ranges, comparison.scans.ranges
    known = comparison.beams.cosine > 0
    edges, mixed = np.zeros_like(ranges), np.zeros_like(ranges)
    near = np.minimum(ranges[:, :-1], ranges[:, 1:])
    far = np.maximum(ranges[:, :-1], ranges[:, 1:])
    with np.errstate(invalid="ignore"):
        depth = np.where(known[:, :-1] & known[:, 1:], far - near, 0.0)
    edge = (depth > JUMP) & comparison.used[:, None]
    edges[:, :-1][edge] = 1 - 2 * EDGE_DISTANCE / depth[edge]
    for shift in (-1, 0, 1):
        beam = np.roll(measured, -shift, axis=1)[:, :-1]
        mixed[:, :-1] += edge & (beam > near + EDGE_DISTANCE) & (beam < far - EDGE_DISTANCE)
    return mixed, edges


@dataclass(frozen=True)
class FittedNoise:
    """Noise of a log's lidar.

    Attributes:
        noise: Fitted noise.
        low: lower bounds of its 95 % confidence intervals.
        high: upper bounds.
        samples: noise of each bootstrap sample.
        map_width: (bins,) width that the map explains, meters.
        distance: Kolmogorov distance between real and simulated residuals.
        real: statistics of the log.
        simulated: statistics of the log simulated with `noise`.
        poses: (n, 3) matched poses of the simulated scans, of which the log's matched poses are the truth.
    """

    noise: LidarNoise
    low: LidarNoise
    high: LidarNoise
    samples: tuple[LidarNoise, ...]
    map_width: FloatArray
    distance: float
    real: Sample
    simulated: Sample
    poses: FloatArray


def resolution_of(ranges: FloatArray) -> float:
    """Return the largest usual step that all ranges are multiples of, meters; 0 = none."""
    found = ranges[np.isfinite(ranges)]
    for step in (0.05, 0.01, 0.005, 0.001):
        if np.mean(np.abs(found / step - np.round(found / step)) * step < 1e-5) > 0.999:
            return step
    return 0.0


def fit_noise(real: LogComparison, start: FloatArray, seed: int) -> FittedNoise:
    """Fit the noise with which the simulated log has the residuals of the real one.

    The log is simulated in its own map, and mapped, localized and compared as the real one. The width that
    remains without noise is the map's; the noise has the rest. Each round simulates with the noise so far.
    """
    sample = Sample.of(real)
    if len(sample.residual) < MIN_RESIDUALS or not np.isfinite(sample.widths(sample.blocks)).any():
        raise SourceError(
            f"at least {MIN_RESIDUALS} beams of one range must meet known walls, got {len(sample.residual)}"
        )
    lost, mixed = sample.shares(sample.blocks)
    step = resolution_of(real.scans.ranges)
    width = float(np.nanmedian(sample.widths(sample.blocks)))
    noise = LidarNoise(sigma=width, quantization=step, dropout=float(lost), mixed_pixels=float(mixed))
    for k in range(ROUNDS):
        control = Sample.of(*_compare_simulations(real, start, noise, seed + k))
        fitted, map_width = _correct(sample, control, sample.blocks, noise)
        if k < ROUNDS - 1:
            noise = fitted
    # The interval is that of random blocks, drawn with replacement.
    rng, blocks = np.random.default_rng(seed), np.intersect1d(sample.blocks, control.blocks)
    drawn = [_correct(sample, control, rng.choice(blocks, len(blocks)), noise)[0] for _ in range(SAMPLES)]
    rows = [[getattr(draw, name) for name in FITTED] for draw in drawn]
    low, high = (
        replace(drawn[0], **dict(zip(FITTED, ends, strict=True)))
        for ends in np.quantile(rows, (0.025, 0.975), axis=0).tolist()
    )
    last = _compare_simulations(real, start, fitted, seed + ROUNDS)
    final = Sample.of(*last)
    distance = residual_distance(sample, final)
    poses = last[0].scans.poses
    return FittedNoise(fitted, low, high, tuple(drawn), map_width, distance, sample, final, poses)


def _compare_simulations(
    real: LogComparison, start: FloatArray, noise: LidarNoise, seed: int
) -> list[LogComparison]:
    """Return comparisons of simulated logs; a short log is simulated several times."""
    repeats = -(-LEAST_SCANS // len(start))
    seeds = (seed + STRIDE * k for k in range(repeats))
    return [compare(simulate_scans(real, start, noise, each)) for each in seeds]


def residual_distance(real: Sample, other: Sample) -> float:
    """Return the Kolmogorov distance between the residuals of two comparisons."""
    return float(ks_2samp(real.residual, other.residual).statistic)


def _correct(
    real: Sample, control: Sample, blocks: IntArray, noise: LidarNoise
) -> tuple[LidarNoise, FloatArray]:
    """Return the noise corrected by a simulation with `noise`, and (bins,) the map's width, meters."""
    wide, simulated_wide = real.widths(blocks), control.widths(blocks)
    count, _ = np.histogram(real.ranges, BINS)
    middle = np.histogram(real.ranges, BINS, weights=real.ranges)[0] / np.maximum(count, 1)
    added = noise.sigma + noise.sigma_relative * middle
    map_square = simulated_wide**2 - added**2
    known = np.isfinite(wide) & np.isfinite(simulated_wide)
    rest = np.sqrt(np.maximum(wide**2 - map_square, FLOOR**2))[known]
    if not known.any():
        return noise, np.sqrt(np.maximum(map_square, 0.0))
    weight = np.sqrt(count[known])
    design = np.column_stack((np.ones(known.sum()), middle[known])) * weight[:, None]
    sigma, relative = nnls(design, rest * weight)[0].tolist()
    lost, mixed = (real.shares(blocks) - control.shares(blocks)).tolist()
    fitted = replace(
        noise,
        sigma=sigma,
        sigma_relative=relative,
        dropout=min(max(noise.dropout + lost, 0.0), 1.0),
        mixed_pixels=min(max(noise.mixed_pixels + mixed, 0.0), 1.0),
    )
    return fitted, np.sqrt(np.maximum(map_square, 0.0))


def curve(sample: Sample) -> list[dict[str, float]]:
    """Return count, bias, width and tails of the residuals of each bin of ranges."""
    rows = []
    for low, high in pairwise(BINS):
        inside = (sample.ranges >= low) & (sample.ranges < high)
        residual = sample.residual[inside]
        if len(residual) >= MIN_RESIDUALS:
            lower, bias, upper = np.quantile(residual, (0.1587, 0.5, 0.8413)).tolist()
            width = (upper - lower) / 2
            tails = float(np.mean(np.abs(residual - bias) > 3 * width))
            row = {"range": float(sample.ranges[inside].mean()), "beams": len(residual), "bias": bias}
            rows.append(row | {"width": width, "tails": tails})
    return rows


@dataclass(frozen=True)
class FittedOdometry:
    """Odometry errors with 95 % confidence intervals.

    Attributes:
        segments: count of segments.
        scale: constant part of the distance's scale error.
        scale_sigma: deviation of the scale error, and interval.
        rate_sigma: white noise of the turn rate in each update of a simulation, rad/s, and interval.
        rate_bias: absolute mean error of the turn rate while the robot moves, rad/s.
        samples: (SAMPLES, 2) `scale_sigma` and `rate_sigma` of each bootstrap sample.
    """

    segments: int
    scale: float
    scale_sigma: tuple[float, float, float]
    rate_sigma: tuple[float, float, float]
    rate_bias: float
    samples: FloatArray


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
        scale_length: Correlation length of the scale error, meters.
        seed: Seed of the bootstrap.

    Returns:
        None if the path has too few segments.
    """
    keys, ends = _segments(poses)
    if len(ends) <= SEGMENTS:
        return None
    # Wheels at rest have no error.
    moving = np.any(np.diff(odometry, axis=0) != 0, axis=1)
    clock = np.concatenate(([0.0], np.cumsum(np.diff(stamps) * moving)))
    times = np.diff(clock[keys][ends])
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
    return FittedOdometry(n, float(np.median(found[:, 0])), scale, rate, bias, fits[1:])


def odometry_deviations(odometry: FloatArray, poses: FloatArray) -> tuple[float, float] | None:
    """Return deviations of distance, relative, and turn, radians, over segments of 5 m.

    The odometry (n, 3) is in any frame, the poses (n, 3) are true or matched. None if the path has too few
    segments.
    """
    keys, ends = _segments(poses)
    if len(ends) <= SEGMENTS:
        return None
    distance, turn = _errors(odometry[keys], poses[keys], ends)
    return math.sqrt(_variance(distance)), math.sqrt(_variance(turn))


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

    Both (n, 3) are errors of distance and turn, and seconds, of each segment. The mean is the variance of a
    segment's mean scale error over that of the scale error.
    """
    scale = max(_variance(found[:, 0]) - _variance(matching[:, 0]), 0.0) / mean
    rates = []
    for errors in (found, matching):
        turn, seconds = errors[:, 1], errors[:, 2]
        rate = turn.sum() / seconds.sum()
        variance, plain = _variance(turn - rate * seconds), _variance(turn)
        if plain < variance:
            # These errors grow with the distance. A simulated constant rate spreads the turns of segments of
            # different times; noise has the rest.
            variance = max(plain - rate**2 * float(np.var(seconds, ddof=1)), 0.0)
        rates.append(variance / (CONTROL_PERIOD * float(seconds.mean())))
    return math.sqrt(scale), math.sqrt(max(rates[0] - rates[1], 0.0))


def _variance(values: FloatArray) -> float:
    """Return the variance, with outliers moved to four deviations from the median."""
    low, middle, high = np.quantile(values, (0.1587, 0.5, 0.8413)).tolist()
    reach = OUTLIER * (high - low) / 2
    return float(np.var(np.clip(values, middle - reach, middle + reach), ddof=1))
