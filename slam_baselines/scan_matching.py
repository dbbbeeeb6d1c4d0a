"""Scan-to-map matching by Gauss-Newton on the interpolated occupancy, coarse to fine.

Kohlbrecher et al. 2011, "A flexible and scalable SLAM system with full 3D motion estimation",
eqs. 4-14, with the odometry as a prior: the cost of a pose x is

    sum_i w_i (1 - M(S_i(x)))^2 / sigma^2  +  (x - x_prior)' Lambda (x - x_prior),

so that a direction in which the map says nothing (a long corridor, open terrain) follows the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from slam_baselines.matching_kernels import fit, levels_for, match
from slam_baselines.occupancy import OccupancyMap
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
        self._ones: Array = np.ones(0)
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
        match(
            pyramid.values, pyramid.frames, points, weights,
            prior, information, prior if start is None else start,
            self._iterations[:levels], c.sigma**2, c.converged, True, out,
        )  # fmt: skip
        return Match(out[:3].copy(), out[3:12].reshape(3, 3).copy(), *out[12:].tolist())

    def fit(
        self, pyramid: MapPyramid, points: Array, weights: Array | None, share: float,
        prior: Array, covariance: Array, start: Array | None = None,
    ) -> tuple[Match, Array]:  # fmt: skip
        """Fit the scan into the map; return the match and the (3, 3) covariance with the prior's in it.

        Args:
            pyramid: the map.
            points: (n, 2 or more) ends of beams in the levelled base frame, metres.
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

    def levels(self, pyramid: MapPyramid, covariance: Array) -> int:
        """Return how many levels it takes to catch an error of two standard deviations.

        A level is needed where the error exceeds the cell of the next finer one; coarse levels that are
        not needed would only carry the estimate away from a good start.
        """
        return int(levels_for(pyramid.frames, covariance, self._config.lever))
