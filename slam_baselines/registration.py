"""Scan registration: update of the predicted estimate by matching the scan to the map.

Gauss-Newton starts from the expected pose, which is a prior, so that a direction which the map does not
constrain follows the odometry. A poor fit leads to a wider, correlative search (Hess et al. 2016, section
IV-C: ceres_scan_matcher and real_time_correlative_scan_matcher).

The Gauss-Newton matcher works on the interpolated occupancy, coarse to fine (Kohlbrecher et al. 2011, "A
flexible and scalable SLAM system with full 3D motion estimation", eqs. 4-14). The cost of a pose x is

    sum_i w_i (1 - M(S_i(x)))^2 / sigma^2  +  (x - x_prior)' Lambda (x - x_prior).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from lirs_wct.errors import limited, require_within
from lirs_wct.geometry import FloatArray, IntArray, Pose2, njit
from slam_baselines.correlative_search import correlative_search
from slam_baselines.dead_reckoning import PoseEstimate, moved_covariance
from slam_baselines.monitors import MonitorConfig
from slam_baselines.occupancy_map import FULL, UNSEEN, Levels, MapPyramid

BEAM_DEVIATION = 0.3
"""Standard deviation of one beam's 1 - M, with the correlation between beams in it."""
CONVERGED = 0.02
"""Length of a step below which a level ends, cells (and tenths of a radian)."""
LEVER = 3.0
"""Distance at which an error of yaw is felt, meters."""


class Match(NamedTuple):
    """A scan matched to a map.

    Attributes:
        pose: (3,) x, y, yaw of `T_map_base`.
        covariance: (3, 3) of the pose, by scan and prior.
        information: (3, 3) of the scan alone at that pose.
        score: mean occupancy at the ends of beams that fall on known cells; 0 where none does.
        known: share of the beams that fall on known cells.
    """

    pose: FloatArray
    covariance: FloatArray
    information: FloatArray
    score: float
    known: float


class Matchable(Protocol):
    """Map that scans can be matched to: a MapPyramid or a Submap."""

    @property
    def levels(self) -> Levels:
        """Arrays of the map for matching, finest level first."""
        ...


class ScanMatcher:
    """Gauss-Newton matching against a pyramid."""

    def __init__(self, iterations: Sequence[int] = (5, 3, 3), *, exact: bool = False) -> None:
        """Set the largest numbers of Gauss-Newton steps on each level, finest first.

        With `exact`, score and information are those of the final pose; else of a pose one last, tiny step
        away, which saves a pass over the scan.
        """
        self._iterations: IntArray = np.array(iterations)
        self._exact = exact
        self._ones: FloatArray = np.ones(0)

    def match(
        self, pyramid: Matchable, points: FloatArray, weights: FloatArray | None, prior: PoseEstimate, *,
        start: FloatArray | None = None, levels: int = 0, information_share: float = 1.0,
    ) -> Match:  # fmt: skip
        """Match the scan to the map.

        Args:
            pyramid: Map to match to.
            points: (n, 2 or more) ends of beams in the leveled base frame, meters.
            weights: (n,) of the beams; None: all the same.
            prior: Expected pose.
            start: (3,) first pose; None: the prior's.
            levels: Levels to use, the finest last; 0: enough for an error of two of the prior's deviations.
            information_share: Share of its information that the scan adds.
        """
        if weights is None:
            if len(self._ones) < len(points):
                self._ones = np.ones(len(points))
            weights = self._ones[: len(points)]
        out, expected = np.empty(23), prior.pose.as_array()
        _match(
            pyramid.levels, points, weights, expected, prior.covariance, expected if start is None else start,
            levels, self._iterations, self._exact, BEAM_DEVIATION**2 / information_share, out,
        )  # fmt: skip
        score, known = out[21:].tolist()
        return Match(out[:3], out[3:12].reshape(3, 3), out[12:21].reshape(3, 3), score, known)


@njit
def levels_for(frames: Any, covariance: Any) -> int:
    """Return the number of levels that correct an error of two standard deviations.

    A level is needed where the error exceeds the cell of the next finer one; coarse levels that are not
    needed would only move the estimate away from a good start.
    """
    error = np.sqrt(max(covariance[0, 0], covariance[1, 1])) + LEVER * np.sqrt(covariance[2, 2])
    levels = 1
    while levels < len(frames) and 2 * error > frames[levels - 1, 2]:
        levels += 1
    return levels


@njit
def _match(
    pyramid: Levels, points: Any, weights: Any, expected: Any, prior: Any, start: Any, levels: int,
    iterations: Any, exact: bool, variance: float, out: Any,
) -> None:  # fmt: skip
    """Match beams of a `variance` with a covariance as prior (3, 3); fill `out` (23,).

    `out` holds pose, covariance with the prior, information, score, share of beams on known cells.
    """
    information = invert3(prior)
    if levels == 0:
        levels = levels_for(pyramid.frames, prior)
    pose, H, total = start.copy(), np.empty((3, 3)), 0.0
    score, known = _iterate(
        pyramid, points, weights, expected, information, levels, iterations, exact, variance, pose, H
    )
    # Number by number: operations of whole arrays take Numba several times as long to compile.
    for i in range(3):
        for j in range(3):
            H[i, j] /= variance
            information[i, j] += H[i, j]
    covariance = invert3(information)
    for i in range(3):
        out[i] = pose[i]
        for j in range(3):
            out[3 + 3 * i + j], out[12 + 3 * i + j] = covariance[i, j], H[i, j]
    for w in weights:
        total += w
    out[21], out[22] = score / max(known, 1e-9), known / max(total, 1e-9)


@njit
def _iterate(
    pyramid: Levels, points: Any, weights: Any, prior: Any, information: Any, levels: int,
    iterations: Any, exact: bool, variance: float, pose: Any, H: Any,
) -> tuple[float, float]:  # fmt: skip
    """Run Gauss-Newton from the coarsest level to the finest; return score and known weight.

    `pose` (3,) is moved, and `H` (3, 3) filled with the Hessian of the cost there.
    """
    g, A, b = np.empty(3), np.empty((3, 3)), np.empty(3)
    score = known = 0.0
    # Not a literal 1, of which Numba would compile the last call once more.
    converged, stride = False, np.int64(1)
    for level in range(min(levels, len(iterations)) - 1, -1, -1):
        value, frame = pyramid.values[level], pyramid.frames[level]
        cell = frame[2]
        stride = np.int64(1 << level)  # a coarse level needs fewer beams
        for _ in range(iterations[level]):
            score, known = linearize(value, frame, points, weights, stride, pose, H, g)
            for i in range(3):
                b[i] = g[i] * stride / variance
                for j in range(3):
                    A[i, j] = H[i, j] * stride / variance + information[i, j]
                    b[i] -= information[i, j] * (pose[j] - prior[j])
            step = solve3(A, b)
            length = np.hypot(step[0], step[1])
            share = 4 * cell / max(4 * cell, length, abs(step[2]) * 20 * cell)
            for i in range(3):
                pose[i] += step[i] * share
            converged = length < CONVERGED * cell and abs(step[2]) < CONVERGED * 0.1
            if converged:
                break
    if exact or not converged:
        # The stride is the finest level's, 1.
        score, known = linearize(pyramid.values[0], pyramid.frames[0], points, weights, stride, pose, H, g)
    return score, known


@njit(inline="always")
def _interpolate(value: Any, u: float, v: float) -> Any:
    """Return the map's value, its derivatives, and whether any cell is known."""
    # Unsigned: an index that might be negative costs a comparison.
    col, row, one = np.uintp(int(u)), np.uintp(int(v)), np.uintp(1)
    u -= int(u)
    v -= int(v)
    sw, se = value[row, col], value[row, col + one]
    nw, ne = value[row + one, col], value[row + one, col + one]
    south, north = sw + u * (float(se) - sw), nw + u * (float(ne) - nw)
    dx = (float(se) - sw) * (1 - v) + (float(ne) - nw) * v
    known = not (sw == UNSEEN and se == UNSEEN and nw == UNSEEN and ne == UNSEEN)
    return south + v * (north - south), dx, north - south, known


@njit
def linearize(
    value: Any, frame: Any, points: Any, weights: Any, stride: int, pose: Any, H: Any, g: Any
) -> tuple[float, float]:
    """Fill Hessian and gradient of the matching cost (eqs. 12-13); return score and known weight."""
    rows, cols = value.shape
    scale = 1 / frame[2]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    u0, v0 = pose[0] * scale - 0.5 - frame[1], pose[1] * scale - 0.5 - frame[0]
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = 0.0
    seen = score = 0.0
    for i in range(0, len(points), stride):
        w = weights[i]
        if w == 0.0:
            continue
        px, py = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        u, v = u0 + px * scale, v0 + py * scale
        if not (u >= 0 and v >= 0 and u < cols - 1 and v < rows - 1):
            continue
        m, dx, dy, known = _interpolate(value, u, v)
        if known:
            seen += w
            score += w * m
        dyaw, e = dy * px - dx * py, w * (FULL - m)
        h00 += w * dx * dx
        h01 += w * dx * dy
        h02 += w * dx * dyaw
        h11 += w * dy * dy
        h12 += w * dy * dyaw
        h22 += w * dyaw * dyaw
        g0 += dx * e
        g1 += dy * e
        g2 += dyaw * e
    unit = scale / FULL
    square = unit * unit
    H[0, 0], H[1, 1], H[2, 2] = h00 * square, h11 * square, h22 * square
    H[0, 1] = H[1, 0] = h01 * square
    H[0, 2] = H[2, 0] = h02 * square
    H[1, 2] = H[2, 1] = h12 * square
    g[0], g[1], g[2] = g0 * unit / FULL, g1 * unit / FULL, g2 * unit / FULL
    return score / FULL, seen


@njit
def solve3(A: Any, b: Any) -> Any:
    """Solve a symmetric positive definite 3x3 system by Cramer's rule; zero where it is singular."""
    inverse = invert3(A)
    x = np.zeros(3)
    for i in range(3):
        for j in range(3):
            x[i] += inverse[i, j] * b[j]
    return x


@njit
def invert3(A: Any) -> Any:
    """Return the inverse of a symmetric positive definite matrix; zeros where it is singular."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c01 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c02 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    B = np.zeros((3, 3))
    if not det > 0:
        return B
    B[0, 0], B[1, 1] = c00 / det, (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]) / det
    B[2, 2] = (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]) / det
    B[0, 1] = B[1, 0] = c01 / det
    B[0, 2] = B[2, 0] = c02 / det
    B[1, 2] = B[2, 1] = (A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1]) / det
    return B


@dataclass(frozen=True, kw_only=True)
class RegistrationConfig(MonitorConfig):
    """Acceptance of matches, and the wider search where they are poor.

    Attributes:
        linear_search_window: Largest shift of the wider search in x and in y, meters.
        angular_search_window: Largest turn of the wider search, radians.
        search_threshold: Mean occupancy at the ends of the beams below which the wider search begins.
        min_gain: Gain of the score that the wider search needs to be preferred.
        search_prior: Whether the fit after the wider search keeps the prior of dead reckoning; else its prior
            is as wide as the window.
        coasting: Whether the wider search also starts at the pose after repeating the last motion.
        min_beams: Fewest beams on known cells for a match.
        min_walls: Fewest hits on walls for a match on uneven ground, where a wall may be ground.
        decorrelation_distance: Distance between scans below which they see the same cells with the same
            errors, so that each adds only its share of information, meters.
        min_information_share: Smallest share of information that a scan adds.
        agreement_gate: Deviations of dead reckoning up to which a match agrees with the one before.

    Raises:
        ConfigError: a value is not legal, or lost_score is above search_threshold.
    """

    linear_search_window: float = limited(0.7, "(0, inf]")
    angular_search_window: float = limited(0.5, "(0, inf]")
    search_threshold: float = limited(0.4, "(0, 1)")
    min_gain: float = limited(0.05, "[0, inf]")
    search_prior: bool = False
    coasting: bool = True
    min_beams: int = limited(15, "[1, inf]")
    min_walls: int = limited(40, "[1, inf]")
    decorrelation_distance: float = limited(0.4, "(0, inf]")
    min_information_share: float = limited(0.02, "(0, 1)")
    agreement_gate: float = limited(2.0, "(0, inf]")

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, f"(0, {self.search_threshold}]", "lost_score")


REGISTERED = np.diag((0.03**2, 0.03**2, 0.005**2))
"""Covariance of a registered scan's pose."""


class ReckoningWindow:
    """Corrections of dead reckoning over the latest meters, against its own errors.

    Matches to hillsides pull steadily or jump, farther than wheels and gyro err. A correction enters only in
    the directions in which all corrections of the window together stay within those errors. Directions are
    the eigenvectors of the scan's information in units of these errors.
    """

    def __init__(self, config: MonitorConfig) -> None:
        self._config = config
        self._correction, self._covariance = np.zeros(3), np.zeros((3, 3))
        self._expected: FloatArray | None = None
        self._moved = 0.0

    def move(self, before: PoseEstimate, expected: PoseEstimate) -> None:
        """Add the step of dead reckoning from the last used estimate."""
        start, end = before.pose.as_array(), expected.pose.as_array()
        dx, dy = (end - start)[:2].tolist()
        noise = expected.covariance - moved_covariance(before.covariance, dx, dy, 0.0, 0.0)
        keep = math.exp(-math.hypot(dx, dy) / self._config.reckoning_length)
        if self._expected is not None:
            self._correction += difference(start, self._expected)
        x, y, yaw = self._correction
        self._correction = keep * np.array((x - dy * yaw, y + dx * yaw, yaw))
        self._covariance = keep**2 * moved_covariance(self._covariance, dx, dy, 0.0, 0.0) + noise
        self._expected = end
        self._moved += math.hypot(dx, dy) + 0.5 * abs(difference(end, start)[2])

    def allowed(self, expected: PoseEstimate, pose: FloatArray, information: FloatArray) -> FloatArray:
        """Return the projection (3, 3) of corrections in the map frame on the allowed directions.

        The scan of this information (3, 3) was matched at a pose (3,).
        """
        root = np.linalg.cholesky(self._covariance + REGISTERED)
        inverse = np.linalg.inv(root)
        gains, axes = np.linalg.eigh(root.T @ information @ root)
        total = self._correction + difference(pose, expected.pose.as_array())
        within = (gains >= 1.0) & (abs(axes.T @ inverse @ total) <= self._config.reckoning_gate)
        return np.asarray(root @ (axes * within) @ axes.T @ inverse)


MATCHED, BIAS = np.diag((0.005**2, 0.005**2, 0.002**2)), 0.15
"""Covariance of the difference of two matches to walls; standard deviation of the odometry's scale error."""


class MatchMonitor(ReckoningWindow):
    """Test of each match against the last one, moved by dead reckoning.

    Matches to walls differ from it by noise and the steady errors of the wheels, those to hillsides by more,
    however well each scan fits.
    """

    def __init__(self, config: RegistrationConfig) -> None:
        super().__init__(replace(config, reckoning_length=math.inf))
        self._gate, self._distance = config.agreement_gate, config.decorrelation_distance
        self._agreed, self._off = math.inf, np.zeros(3)

    def agrees(self, expected: PoseEstimate, pose: FloatArray) -> bool:
        """Add a match at a pose (3,); return whether matches have agreed over the required distance."""
        moved, correction = self._moved, difference(pose, expected.pose.as_array())
        off, bias = self._correction + correction, (BIAS * moved) ** 2 * np.diag((1.0, 1.0, 0.0))
        spread = self._covariance + MATCHED + bias
        # Slipping wheels cause the same correction again.
        square = min(float(d @ solve3(spread, d)) for d in (off, off - self._off))
        self._agreed = self._agreed + moved if square <= self._gate**2 else 0.0
        self._moved, self._off = 0.0, off
        self._correction, self._covariance = -correction, np.zeros((3, 3))
        return self._agreed >= self._distance


def difference(pose: FloatArray, other: FloatArray) -> FloatArray:
    """Return a pose (3,) less another, the heading in [-pi, pi]."""
    off = pose - other
    off[2] = math.remainder(off[2], math.tau)
    return off


class Registration:
    """Registration of scans in a map; counts its wider searches."""

    def __init__(self, config: RegistrationConfig, matcher: ScanMatcher) -> None:
        self.config = config
        self.searches = 0
        self._matcher = matcher
        self._monitor = MatchMonitor(config)

    def again(self) -> Registration:
        """Return a registration without past matches, for other poses of the same scans."""
        return Registration(self.config, self._matcher)

    def register(
        self, pyramid: MapPyramid, hits: FloatArray, weights: FloatArray | None, expected: PoseEstimate,
        before: PoseEstimate, earlier: Pose2 | None = None, *, trusted_score: float = 0.0,
    ) -> tuple[PoseEstimate, Match | None]:  # fmt: skip
        """Return the estimate and its match; `expected` and None without enough walls.

        Args:
            pyramid: Map to match to.
            hits: (n, 2 or more) ends of beams in the leveled base frame, meters.
            weights: (n,) 1 for walls, less for slopes, 0 for possible ground; None on flat ground.
            expected: Estimate by dead reckoning.
            before: Estimate at the last registration, as it was used.
            earlier: Pose of the one before that, for coasting.
            trusted_score: Score from which a match is used though it disagrees with those before.
        """
        c = self.config
        self._monitor.move(before, expected)
        uneven, walls = weights is not None, len(hits) if weights is None else np.count_nonzero(weights)
        if walls < (c.min_walls if uneven else c.min_beams):
            return expected, None
        x, y, yaw = expected.pose.x, expected.pose.y, expected.pose.yaw
        last = before.pose
        turn = math.remainder(yaw - last.yaw, math.tau)
        moved = math.hypot(x - last.x, y - last.y) + 0.5 * abs(turn)
        share = min(1.0, max(c.min_information_share, moved / c.decorrelation_distance))
        match = self._matcher.match(pyramid, hits, weights, expected, information_share=share)
        if match.known < c.min_beams / walls:
            return expected, None
        forced = False
        if match.known >= c.known_ratio and match.score < c.search_threshold:
            coasting = last if earlier is None else last @ (earlier.inverse() @ last)
            wider = self._search(pyramid, hits, weights, share, expected, coasting)
            # Dead reckoning errs less than a forced fit.
            forced = uneven and max(match.score, wider.score) < c.search_threshold
            if not forced and wider.score > match.score + c.min_gain:
                match = wider
        x, y, yaw = match.pose.tolist()
        matched = PoseEstimate(Pose2(x, y, math.remainder(yaw, math.tau)), match.covariance)
        used = self._monitor.agrees(expected, match.pose) or match.score >= trusted_score
        return matched if used and not forced else expected, match

    def _search(
        self,
        pyramid: MapPyramid,
        hits: FloatArray,
        weights: FloatArray | None,
        share: float,
        prior: PoseEstimate,
        coasting: Pose2,
    ) -> Match:
        """Match from the best pose of the wider window, and after repeating the last step."""
        self.searches += 1
        c = self.config
        linear, angular = c.linear_search_window, c.angular_search_window
        points_weights = np.ones(len(hits)) if weights is None else weights
        start = correlative_search(
            pyramid.maps[-1].grid, hits, points_weights, prior.pose.as_array(), linear, angular
        )
        if not c.search_prior:
            prior = PoseEstimate(prior.pose, np.diag((linear**2, linear**2, angular**2)))
        matches = [
            self._matcher.match(
                pyramid, hits, weights, prior, start=first, levels=len(pyramid.maps), information_share=share
            )
            for first in ((start, coasting.as_array()) if c.coasting else (start,))
        ]
        return max(matches, key=lambda match: match.score)
