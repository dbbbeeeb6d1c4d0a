"""Scan-to-map matching by Gauss-Newton on the interpolated occupancy, coarse to fine.

Kohlbrecher et al. 2011, "A flexible and scalable SLAM system with full 3D motion estimation",
eqs. 4-14, with the odometry as a prior: the cost of a pose x is

    sum_i w_i (1 - M(S_i(x)))^2 / sigma^2  +  (x - x_prior)' Lambda (x - x_prior),

so that a direction in which the map says nothing (a long corridor, open terrain) follows the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from slam_baselines.common.linalg import invert3
from slam_baselines.common.linalg import solve3 as solve3
from slam_baselines.mapping.occupancy_map import FULL, UNSEEN, OccupancyMap


@dataclass(frozen=True, kw_only=True)
class MatchConfig:
    """How hard the matcher tries, and what it believes of its own result.

    Attributes:
        iterations: most Gauss-Newton steps on each level, finest first.
        sigma: standard deviation of one beam's 1 - M, with the correlation between beams in it.
        converged: a level ends when a step is shorter than this many of its cells (and radians / 10).
        lever: distance at which an error of yaw is felt, metres.

    Raises:
        ConfigError: a value that is not above 0.
    """

    iterations: tuple[int, ...] = (5, 3, 3)
    sigma: float = 0.3
    converged: float = 0.02
    lever: float = 3.0

    def __post_init__(self) -> None:
        if min(self.iterations) < 1:
            raise ConfigError(f"iterations must be at least 1 on every level, got {self.iterations}")
        if not (self.sigma > 0 and self.converged > 0):
            raise ConfigError(f"sigma and converged must be above 0, got {self.sigma} and {self.converged}")


@dataclass(frozen=True, slots=True)
class Match:
    """Where a scan fits into a map.

    Attributes:
        pose: (3,) x, y, yaw of `T_map_base`.
        information: (3, 3) of the scan alone at that pose.
        score: mean occupancy at the ends of beams that fall on known cells; 0 where none does.
        beams: sum of the weights of beams on known cells.
        known: share of the beams that fall on known cells.
    """

    pose: FloatArray
    information: FloatArray
    score: float
    beams: float
    known: float


class MapPyramid:
    """Occupancy maps of growing cell size, finest first, laid out for the matcher's kernel."""

    def __init__(self, maps: tuple[OccupancyMap, ...]) -> None:
        self.maps = maps
        self.refresh()

    def refresh(self) -> None:
        """Take over the maps' arrays; needed whenever one of them grew."""
        self.values = tuple(m.layers.value for m in self.maps)
        self.frames: FloatArray = np.array([m.frame for m in self.maps])
        self.cells = tuple(m.resolution for m in self.maps)


class ScanMatcher:
    """Gauss-Newton matching against a pyramid."""

    def __init__(self, config: MatchConfig) -> None:
        self._iterations = np.array(config.iterations)
        self._config = config
        self._ones: FloatArray = np.ones(0)
        self._out = np.zeros(15)

    def match(
        self,
        pyramid: MapPyramid,
        points: FloatArray,
        weights: FloatArray,
        prior: FloatArray,
        information: FloatArray,
        levels: int,
        start: FloatArray | None = None,
    ) -> Match:
        """Fit the scan into the map.

        Args:
            pyramid: the map.
            points: (n, 2 or more) ends of beams in the leveled base frame, metres.
            weights: (n,) how much each counts.
            prior: (3,) expected x, y, yaw.
            information: (3, 3) inverse covariance of the prior.
            levels: how many levels to use, the finest last.
            start: (3,) where to begin, if not at the prior.
        """
        out = self._out
        c = self._config
        match(
            pyramid.values, pyramid.frames, points, weights,
            prior, information, prior if start is None else start,
            self._iterations[:levels], c.sigma**2, c.converged, True, out,
        )  # fmt: skip
        return Match(out[:3].copy(), out[3:12].reshape(3, 3).copy(), *out[12:].tolist())

    def fit(
        self, pyramid: MapPyramid, points: FloatArray, weights: FloatArray | None, share: float,
        prior: FloatArray, covariance: FloatArray, start: FloatArray | None = None,
    ) -> tuple[Match, FloatArray]:  # fmt: skip
        """Fit the scan into the map; return the match and the (3, 3) covariance with the prior's in it.

        Args:
            pyramid: the map.
            points: (n, 2 or more) ends of beams in the leveled base frame, metres.
            weights: (n,) how much each counts; None: all the same.
            share: of its information that the scan adds.
            prior: (3,) expected x, y, yaw.
            covariance: (3, 3) of the prior.
            start: (3,) where to begin on all levels; None: at the prior, on as many levels as it takes.
        """
        c, n = self._config, len(points)
        if weights is None:
            if len(self._ones) < n:
                self._ones = np.ones(n)
            weights = self._ones[:n]
        levels = 0 if start is None else len(pyramid.maps)
        out = np.empty(24)
        fit(
            pyramid.values, pyramid.frames, points, weights, prior, covariance,
            prior if start is None else start, levels, self._iterations,
            c.sigma**2 / share, c.converged, c.lever, out,
        )  # fmt: skip
        score, known, total = out[12:15].tolist()
        match = Match(out[:3], out[3:12].reshape(3, 3), score, known, total)
        return match, out[15:].reshape(3, 3)

    def levels(self, pyramid: MapPyramid, covariance: FloatArray) -> int:
        """Return how many levels it takes to catch an error of two standard deviations.

        A level is needed where the error exceeds the cell of the next finer one; coarse levels that are
        not needed would only carry the estimate away from a good start.
        """
        return int(levels_for(pyramid.frames, covariance, self._config.lever))


@njit(cache=True)
def levels_for(frames, covariance, lever):  # type: ignore[no-untyped-def]
    """Return how many levels it takes to catch an error of two standard deviations."""
    error = np.sqrt(max(covariance[0, 0], covariance[1, 1])) + lever * np.sqrt(covariance[2, 2])
    levels = 1
    while levels < len(frames) and 2 * error > frames[levels - 1, 2]:
        levels += 1
    return levels


@njit(cache=True)
def fit(  # type: ignore[no-untyped-def]
    values, frames, points, weights, prior, covariance, start, levels, iterations,
    variance, converged, lever, out,
):  # fmt: skip
    """Match, on as many levels as it takes where `levels` is 0; fill `out` (24,), covariance last."""
    information = invert3(covariance)
    if levels == 0:
        levels = levels_for(frames, covariance, lever)
    used = iterations[:levels]
    match(values, frames, points, weights, prior, information, start, used, variance, converged, False, out)
    for i in range(3):
        for j in range(3):
            information[i, j] += out[3 + 3 * i + j]
    out[15:] = invert3(information).ravel()


@njit(cache=True)
def match(  # type: ignore[no-untyped-def]
    values, frames, points, weights, prior, information, start, iterations, variance, converged, exact, out
):
    """Run Gauss-Newton from the coarsest level to the finest; fill `out` (15 or more).

    Unless it is to be exact, score and information may be those of a pose one last, tiny step away.
    """
    pose = start.copy()
    H, g = np.empty((3, 3)), np.empty(3)
    A, b = np.empty((3, 3)), np.empty(3)
    score = known = 0.0
    settled = False
    for level in range(len(iterations) - 1, -1, -1):
        cell = frames[level, 2]
        stride = 2**level  # a coarse level needs fewer beams to show the way
        for _ in range(iterations[level]):
            score, known = linearize(values[level], frames[level], points, weights, stride, pose, H, g)
            for i in range(3):
                b[i] = g[i] * stride / variance
                for j in range(3):
                    A[i, j] = H[i, j] * stride / variance + information[i, j]
                    b[i] -= information[i, j] * (pose[j] - prior[j])
            step = solve3(A, b)
            length = np.hypot(step[0], step[1])
            pose += step * (4 * cell / max(4 * cell, length, abs(step[2]) * 20 * cell))
            settled = length < converged * cell and abs(step[2]) < converged * 0.1
            if settled:
                break
    if exact or not settled:
        score, known = linearize(values[0], frames[0], points, weights, 1, pose, H, g)
    out[:3] = pose
    out[3:12] = (H / variance).ravel()
    total = max(weights.sum(), 1e-9)
    out[12], out[13], out[14] = score / max(known, 1e-9), known, known / total


@njit(cache=True)
def linearize(value, frame, points, weights, stride, pose, H, g):  # type: ignore[no-untyped-def]
    """Fill Hessian and gradient of the matching cost (eqs. 12-13); return score and known weight.

    Args:
        value: (rows, cols) layer of the map.
        frame: (3,) lattice row and column of its cell (0, 0), resolution in metres.
        points: (n, 2 or more) ends of beams in the leveled base frame.
        weights: (n,) of the beams.
        stride: only every so many beams count.
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
        px, py = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        u, v = u0 + px * scale, v0 + py * scale
        if not (u >= 0 and v >= 0 and u < cols - 1 and v < rows - 1):
            continue
        # Unsigned: an index that might be negative costs a comparison.
        col, row = np.uintp(int(u)), np.uintp(int(v))
        u -= int(u)
        v -= int(v)
        sw, se, nw, ne = (
            value[row, col],
            value[row, col + one],
            value[row + one, col],
            value[row + one, col + one],
        )
        south, north = sw + u * (float(se) - sw), nw + u * (float(ne) - nw)
        m, w = south + v * (north - south), weights[i]
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
