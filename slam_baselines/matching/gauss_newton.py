"""Scan-to-map matching by Gauss-Newton on the interpolated occupancy, coarse to fine.

Kohlbrecher et al. 2011, "A flexible and scalable SLAM system with full 3D motion estimation",
eqs. 4-14, with the odometry as a prior: the cost of a pose x is

    sum_i w_i (1 - M(S_i(x)))^2 / sigma^2  +  (x - x_prior)' Lambda (x - x_prior),

so that a direction which the map does not constrain (a long corridor, open terrain) follows the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.errors import ConfigError
from lirs_wct.field_validators import require_above
from lirs_wct.kernels import njit
from slam_baselines.linalg import invert3, solve3
from slam_baselines.mapping.occupancy_map import FULL, UNSEEN, Levels


@dataclass(frozen=True, kw_only=True)
class MatchConfig:
    """Effort of the matcher, and the noise of a beam.

    Attributes:
        iterations: most Gauss-Newton steps on each level, finest first.
        sigma: standard deviation of one beam's 1 - M, with the correlation between beams in it.
        converged: length of a step below which a level ends, cells (and tenths of a radian).
        lever: distance at which an error of yaw is felt, meters.
        exact: whether score and information are those of the final pose; else of a pose one last, tiny step
            away, which saves a pass over the scan.

    Raises:
        ConfigError: a value that is not above 0.
    """

    iterations: tuple[int, ...] = (5, 3, 3)
    sigma: float = 0.3
    converged: float = 0.02
    lever: float = 3.0
    exact: bool = False

    def __post_init__(self) -> None:
        if min(self.iterations) < 1:
            raise ConfigError(f"iterations must be at least 1 on every level, got {self.iterations}")
        require_above(self, 0, "sigma", "converged", of="the scan matcher")


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


class Prior(NamedTuple):
    """Expected pose.

    Attributes:
        pose: (3,) x, y, yaw.
        covariance: (3, 3).
    """

    pose: FloatArray
    covariance: FloatArray


class _Settings(NamedTuple):
    """MatchConfig for the kernels."""

    iterations: IntArray
    converged: float
    lever: float
    exact: bool


class Matchable(Protocol):
    """Map that scans can be matched to: a MapPyramid or a Submap."""

    @property
    def levels(self) -> Levels:
        """Arrays of the map for matching, finest level first."""
        ...


class ScanMatcher:
    """Gauss-Newton matching against a pyramid."""

    def __init__(self, config: MatchConfig) -> None:
        c = config
        self._variance = c.sigma**2
        self._settings = _Settings(np.array(c.iterations), c.converged, c.lever, c.exact)
        self._ones: FloatArray = np.ones(0)

    def match(
        self, pyramid: Matchable, points: FloatArray, weights: FloatArray | None, prior: Prior, *,
        start: FloatArray | None = None, levels: int = 0, information_share: float = 1.0,
    ) -> Match:  # fmt: skip
        """Match the scan to the map.

        Args:
            pyramid: the map.
            points: (n, 2 or more) ends of beams in the leveled base frame, meters.
            weights: (n,) of the beams; None: all the same.
            prior: expected pose.
            start: (3,) first pose; None: the prior's.
            levels: number of levels, of which the finest comes last; 0: enough to correct an error of two
                standard deviations of the prior.
            information_share: share of its information that the scan adds.
        """
        if weights is None:
            if len(self._ones) < len(points):
                self._ones = np.ones(len(points))
            weights = self._ones[: len(points)]
        out = np.empty(23)
        _match(
            pyramid.levels, points, weights, prior, prior.pose if start is None else start, levels,
            self._settings, self._variance / information_share, out,
        )  # fmt: skip
        score, known = out[21:].tolist()
        return Match(out[:3], out[3:12].reshape(3, 3), out[12:21].reshape(3, 3), score, known)


@njit(cache=True, nogil=True)
def levels_for(frames: Any, covariance: Any, lever: float) -> int:
    """Return the number of levels that correct an error of two standard deviations.

    A level is needed where the error exceeds the cell of the next finer one; coarse levels that are not
    needed would only move the estimate away from a good start.
    """
    error = np.sqrt(max(covariance[0, 0], covariance[1, 1])) + lever * np.sqrt(covariance[2, 2])
    levels = 1
    while levels < len(frames) and 2 * error > frames[levels - 1, 2]:
        levels += 1
    return levels


@njit(cache=True, nogil=True)
def _match(
    pyramid: Levels, points: Any, weights: Any, prior: Prior, start: Any, levels: int, settings: _Settings,
    variance: float, out: Any,
) -> None:  # fmt: skip
    """Match with beams of a `variance`; fill `out` (23,).

    `out` holds pose, covariance with the prior, information, score, share of beams on known cells.
    """
    information = invert3(prior.covariance)
    if levels == 0:
        levels = levels_for(pyramid.frames, prior.covariance, settings.lever)
    pose, H = start.copy(), np.empty((3, 3))
    score, known = _iterate(
        pyramid, points, weights, prior.pose, information, levels, settings, variance, pose, H
    )
    H /= variance
    covariance = invert3(information + H)
    # Number by number: to assign to a slice, Numba first compiles the message of an error for two seconds.
    for i in range(3):
        out[i] = pose[i]
        for j in range(3):
            out[3 + 3 * i + j], out[12 + 3 * i + j] = covariance[i, j], H[i, j]
    out[21], out[22] = score / max(known, 1e-9), known / max(weights.sum(), 1e-9)


@njit(cache=True, nogil=True)
def _iterate(
    pyramid: Levels, points: Any, weights: Any, prior: Any, information: Any, levels: int,
    settings: _Settings, variance: float, pose: Any, H: Any,
) -> tuple[float, float]:  # fmt: skip
    """Run Gauss-Newton from the coarsest level to the finest; return score and known weight.

    `pose` (3,) is moved, and `H` (3, 3) filled with the Hessian of the cost there.
    """
    g, A, b = np.empty(3), np.empty((3, 3)), np.empty(3)
    score = known = 0.0
    # Not a literal 1, of which Numba would compile the last call once more.
    converged_step, stride = False, np.int64(1)
    converged = settings.converged
    for level in range(min(levels, len(settings.iterations)) - 1, -1, -1):
        value, frame = pyramid.values[level], pyramid.frames[level]
        cell = frame[2]
        stride = 2**level  # a coarse level needs fewer beams
        for _ in range(settings.iterations[level]):
            score, known = linearize(value, frame, points, weights, stride, pose, H, g)
            for i in range(3):
                b[i] = g[i] * stride / variance
                for j in range(3):
                    A[i, j] = H[i, j] * stride / variance + information[i, j]
                    b[i] -= information[i, j] * (pose[j] - prior[j])
            step = solve3(A, b)
            length = np.hypot(step[0], step[1])
            pose += step * (4 * cell / max(4 * cell, length, abs(step[2]) * 20 * cell))
            converged_step = length < converged * cell and abs(step[2]) < converged * 0.1
            if converged_step:
                break
    if settings.exact or not converged_step:
        # The stride is the finest level's, 1.
        score, known = linearize(pyramid.values[0], pyramid.frames[0], points, weights, stride, pose, H, g)
    return score, known


@njit(cache=True, nogil=True)
def linearize(
    value: Any, frame: Any, points: Any, weights: Any, stride: int, pose: Any, H: Any, g: Any
) -> tuple[float, float]:
    """Fill Hessian and gradient of the matching cost (eqs. 12-13); return score and known weight.

    Args:
        value: (rows, cols) layer of the map.
        frame: (3,) lattice row and column of its cell (0, 0), resolution in meters.
        points: (n, 2 or more) ends of beams in the leveled base frame.
        weights: (n,) of the beams.
        stride: only every `stride`-th beam counts.
        pose: (3,) x, y, yaw.
        H: (3, 3) to be filled.
        g: (3,) to be filled.
    """
    rows, cols = value.shape
    scale, one = 1 / frame[2], np.uintp(1)
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
        # Unsigned: an index that might be negative costs a comparison.
        col, row = np.uintp(int(u)), np.uintp(int(v))
        u -= int(u)
        v -= int(v)
        sw, se = value[row, col], value[row, col + one]
        nw, ne = value[row + one, col], value[row + one, col + one]
        south, north = sw + u * (float(se) - sw), nw + u * (float(ne) - nw)
        m = south + v * (north - south)
        if not (sw == UNSEEN and se == UNSEEN and nw == UNSEEN and ne == UNSEEN):
            seen += w
            score += w * m
        dx, dy = (float(se) - sw) * (1 - v) + (float(ne) - nw) * v, north - south
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
    H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2] = h00, h01, h02, h11, h12, h22
    H[1, 0], H[2, 0], H[2, 1] = h01, h02, h12
    H *= unit * unit
    g[0], g[1], g[2] = g0 * unit / FULL, g1 * unit / FULL, g2 * unit / FULL
    return score / FULL, seen
