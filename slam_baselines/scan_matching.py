"""Scan-to-map matching by Gauss-Newton on the interpolated occupancy, coarse to fine.

Kohlbrecher et al. 2011, "A flexible and scalable SLAM system with full 3D motion estimation",
eqs. 4-14, with the odometry as a prior: the cost of a pose x is

    sum_i w_i (1 - M(S_i(x)))^2 / sigma^2  +  (x - x_prior)' Lambda (x - x_prior),

so that a direction in which the map says nothing (a long corridor, open terrain) follows the odometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from slam_baselines.occupancy import FULL, UNSEEN, OccupancyMap
from slam_baselines.small_matrices import solve3 as solve3

Array = NDArray[np.float64]


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

    pose: Array
    information: Array
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
        self.frames: Array = np.array([m.frame for m in self.maps])
        self.cells = tuple(m.resolution for m in self.maps)


class ScanMatcher:
    """Gauss-Newton matching against a pyramid."""

    def __init__(self, config: MatchConfig) -> None:
        self._iterations = np.array(config.iterations)
        self._config = config
        self._out = np.zeros(15)

    def match(
        self, pyramid: MapPyramid, points: Array, weights: Array, prior: Array, information: Array,
        levels: int, start: Array | None = None,
    ) -> Match:  # fmt: skip
        """Fit the scan into the map.

        Args:
            pyramid: the map.
            points: (n, 2 or more) ends of beams in the levelled base frame, metres.
            weights: (n,) how much each counts.
            prior: (3,) expected x, y, yaw.
            information: (3, 3) inverse covariance of the prior.
            levels: how many levels to use, the finest last.
            start: (3,) where to begin, if not at the prior.
        """
        out = self._out
        c = self._config
        _match(
            pyramid.values, pyramid.frames, points, weights,
            prior, information, prior if start is None else start,
            self._iterations[:levels], c.sigma, c.converged, out,
        )  # fmt: skip
        return Match(out[:3].copy(), out[3:12].reshape(3, 3).copy(), *out[12:].tolist())

    def levels(self, pyramid: MapPyramid, covariance: Array) -> int:
        """Return how many levels it takes to catch an error of two standard deviations.

        A level is needed where the error exceeds the cell of the next finer one; coarse levels that are
        not needed would only carry the estimate away from a good start.
        """
        reach = 2 * (
            math.sqrt(max(covariance[0, 0], covariance[1, 1]))
            + self._config.lever * math.sqrt(covariance[2, 2])
        )
        return 1 + int((reach > pyramid.frames[:-1, 2]).sum())


@njit(cache=True)
def _match(  # type: ignore[no-untyped-def]
    values, frames, points, weights, prior, information, start, iterations, sigma, converged, out
):
    """Run Gauss-Newton from the coarsest level to the finest; fill `out` (15,)."""
    pose = start.copy()
    H, g = np.empty((3, 3)), np.empty(3)
    A, b = np.empty((3, 3)), np.empty(3)
    score = known = 0.0
    for level in range(len(iterations) - 1, -1, -1):
        cell = frames[level, 2]
        stride = 2**level  # a coarse level needs fewer beams to show the way
        for _ in range(iterations[level]):
            score, known = linearise(values[level], frames[level], points, weights, stride, pose, H, g)
            for i in range(3):
                b[i] = g[i] * stride / sigma**2
                for j in range(3):
                    A[i, j] = H[i, j] * stride / sigma**2 + information[i, j]
                    b[i] -= information[i, j] * (pose[j] - prior[j])
            step = solve3(A, b)
            length = np.hypot(step[0], step[1])
            pose += step * (4 * cell / max(4 * cell, length, abs(step[2]) * 20 * cell))
            if length < converged * cell and abs(step[2]) < converged * 0.1:
                break
    score, known = linearise(values[0], frames[0], points, weights, 1, pose, H, g)
    out[:3] = pose
    out[3:12] = (H / sigma**2).ravel()
    total = max(weights.sum(), 1e-9)
    out[12], out[13], out[14] = score / max(known, 1e-9), known, known / total


@njit(cache=True)
def linearise(value, frame, points, weights, stride, pose, H, g):  # type: ignore[no-untyped-def]
    """Fill Hessian and gradient of the matching cost (eqs. 12-13); return score and known weight.

    Args:
        value: (rows, cols) layer of the map.
        frame: (3,) lattice row and column of its cell (0, 0), resolution in metres.
        points: (n, 2 or more) ends of beams in the levelled base frame.
        weights: (n,) of the beams.
        stride: only every so many beams count.
        pose: (3,) x, y, yaw.
        H: (3, 3) to be filled.
        g: (3,) to be filled.
    """
    rows, cols = value.shape
    scale = 1 / frame[2]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    u0, v0 = pose[0] * scale - 0.5 - frame[1], pose[1] * scale - 0.5 - frame[0]
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = 0.0
    seen = score = 0.0
    for i in range(0, len(points), stride):
        px, py = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        u, v = u0 + px * scale, v0 + py * scale
        if not (u >= 0 and v >= 0 and u < cols - 1 and v < rows - 1):
            continue
        col, row = int(u), int(v)
        u -= col
        v -= row
        sw, se, nw, ne = value[row, col], value[row, col + 1], value[row + 1, col], value[row + 1, col + 1]
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
