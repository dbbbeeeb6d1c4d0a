"""Improved proposal: the pose of a particle by its map and the newest scan.

Grisetti, Stachniss, Burgard 2007, "Improved Techniques for Grid Mapping with Rao-Blackwellized Particle
Filters", section III: the scan is matched to the particle's map from where the odometry puts it; around
the maximum, points x_j are evaluated, and a Gaussian is fitted to them (eqs. 15-17):

    mu = sum_j x_j p_j / eta,   Sigma = sum_j p_j (x_j - mu)(x_j - mu)' / eta,   eta = sum_j p_j,
    p_j = p(z | m, x_j) p(x_j | x_before, u).

The particle's new pose is drawn from N(mu, Sigma), and its weight is multiplied by eta.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray, njit
from slam_baselines.gmapping.config import GmappingConfig
from slam_baselines.gmapping.copy_on_write_map import PatchMaps, PatchMapView
from slam_baselines.gmapping.motion import PoseDistributions
from slam_baselines.gmapping.scan_matching import (
    ALWAYS,
    IF_POOR,
    NEVER,
    OdometryPrior,
    ScanBeams,
    Tuning,
    find_peak,
    invalidate,
    log_prior,
    match_one,
    near_beams,
    score,
)


class Proposal(NamedTuple):
    """One draw for each particle.

    Attributes:
        poses: (particles, 3) x, y, yaw, drawn.
        means: (particles, 3) mu.
        covariances: (particles, 3, 3) Sigma.
        log_eta: (particles,) logarithm of the weights' factors.
        hit_ratio: (particles,) share of the beams on known cells that end at a wall.
        known_ratio: (particles,) share of the beams that end on known cells.
    """

    poses: FloatArray
    means: FloatArray
    covariances: FloatArray
    log_eta: FloatArray
    hit_ratio: FloatArray
    known_ratio: FloatArray


class Proposer:
    """Scan matching in every particle's map, and draws of new poses; counts the wider searches."""

    def __init__(self, config: GmappingConfig) -> None:
        self.config = config
        self.searches = 0
        self._cube = _points(config.samples) * config.spread
        self._tuning = Tuning(*(getattr(config, name) for name in Tuning._fields))

    def propose(
        self,
        maps: PatchMaps,
        beams: ScanBeams,
        wall_slope: int,
        odometry: PoseDistributions,
        first: int,
        rng: np.random.Generator,
        *,
        wide: bool = False,
    ) -> Proposal:
        """Return new poses for all particles from their distributions by odometry.

        The odometry's error is common to all particles: the `first` is matched first, with `wide` always by
        the wider search, and the others try its correction as a second start. Hits of at least the minimum
        slope `wall_slope`, SLOPE_STEP, are walls.
        """
        n = len(odometry.poses)
        proposal = Proposal(*(np.empty((n, *shape)) for shape in ((3,), (3,), (3, 3), (), (), ())))
        normals = rng.standard_normal((n, 3))
        self.searches += propose(
            maps.stack, wall_slope, beams, odometry, first, wide, self._cube, normals, self._tuning, proposal
        )
        return proposal

    def match_scan(
        self,
        view: PatchMapView,
        beams: ScanBeams,
        expected: FloatArray,
        covariance: FloatArray,
        *,
        wide: bool = False,
    ) -> FloatArray | None:
        """Return the (3,) pose of a scan in one map; None without a fit nearby."""
        if beams.weights.sum() < self.config.min_beams:
            return None
        self.searches += wide
        pose: FloatArray
        pose, hit, known = match_one(
            view, beams, expected, covariance, ALWAYS if wide else NEVER, self._tuning
        )
        return pose if hit >= max(self.config.search_threshold * known, self.config.min_beams) else None


def _points(n: int) -> FloatArray:
    """Return (n, 3) evenly spread points of the cube [-1, 1]^3, its center first."""
    # Additive recurrence with the plastic number's relatives: no two points come close.
    g = 1.2207440846057596
    steps = np.array((1 / g, 1 / g**2, 1 / g**3))
    return (np.outer(np.arange(n), steps) + 0.5) % 1.0 * 2 - 1


@njit
def propose(
    maps: Any, wall_slope: int, beams: Any, odometry: Any, first: int, wide: bool, cube: Any, normals: Any,
    tuning: Any, out: Any,
) -> int:  # fmt: skip
    """Fill a proposal; return the number of searches.

    The cube (samples, 3) holds points around a peak, in standard deviations; normal draws are (particles, 3).
    """
    res, (poses, means, sigmas, log_eta, hit_ratio, known_ratio) = maps.resolution, out
    n = len(poses)
    correction, near = np.zeros(3), near_beams(beams, tuning.kernelSize)
    searches, before, searched = 0, first, False
    total = max(beams.weights.sum(), 1e-9)
    for step in range(n):
        k = first if step == 0 else step - 1 if step <= first else step
        if step > 1 and _same(maps, odometry, before, k):
            log_eta[k] = log_eta[before]
            keep(means[before], sigmas[before], means[k], sigmas[k])
            hit_ratio[k], known_ratio[k] = hit_ratio[before], known_ratio[before]
            searches += searched
            continue
        before = k
        view = PatchMapView(maps.tables[k], maps.corner, maps.patches, res, wall_slope)
        prior = OdometryPrior(odometry.poses[k], np.linalg.inv(odometry.covariances[k]))
        invalidate(near)
        start = prior.pose if step == 0 else _better_start(view, near, prior.pose, correction, tuning)
        H = np.empty((3, 3))
        wider = ALWAYS if wide and step == 0 else IF_POOR
        peak, value, hit, known, searched = find_peak(view, beams, near, prior, start, wider, tuning, H)
        searches += searched
        if step == 0:
            correction = between(prior.pose, peak)
        if hit < max(tuning.minimumScore * known, tuning.min_beams):
            keep(prior.pose, odometry.covariances[k], means[k], sigmas[k])
            log_eta[k] = score(view, near, prior.pose, tuning)[0]
        else:
            around = np.linalg.inv(H * (2 * tuning.sigma**2 / tuning.lsigma) + prior.information)
            spread = FitPoints(peak, value, around, cube)
            log_eta[k] = fit(view, near, prior, spread, tuning, means[k], sigmas[k])
        hit_ratio[k], known_ratio[k] = hit / max(known, 1e-9), known / total
    _draw(means, sigmas, normals, poses)
    return searches


@njit
def _better_start(view: Any, near: Any, expected: Any, correction: Any, tuning: Any) -> Any:
    """Return the better start (3,): the expected pose, or that pose corrected."""
    other = compose(expected, correction)
    return other if score(view, near, other, tuning)[0] > score(view, near, expected, tuning)[0] else expected


@njit
def compose(pose: Any, by: Any) -> Any:
    """Return pose @ by, all (3,)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array((pose[0] + c * by[0] - s * by[1], pose[1] + s * by[0] + c * by[1], pose[2] + by[2]))


@njit
def between(a: Any, b: Any) -> Any:
    """Return a^-1 @ b, all (3,)."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return np.array((c * dx + s * dy, c * dy - s * dx, b[2] - a[2]))


@njit
def _draw(means: Any, sigmas: Any, normals: Any, poses: Any) -> None:
    """Fill poses (n, 3) with draws from Gaussians, by standard normal draws (n, 3)."""
    for k in range(len(poses)):
        draw = np.linalg.cholesky(sigmas[k]) @ normals[k]
        for i in range(3):
            poses[k, i] = means[k, i] + draw[i]


@njit
def _same(maps: Any, odometry: Any, a: int, b: int) -> bool:
    """Return whether two particles are copies with the same pose and map."""
    for i in range(3):
        if odometry.poses[a, i] != odometry.poses[b, i]:
            return False
        for j in range(3):
            if odometry.covariances[a, i, j] != odometry.covariances[b, i, j]:
                return False
    _, rows, cols = maps.tables.shape
    for r in range(rows):
        for c in range(cols):
            if maps.tables[a, r, c] != maps.tables[b, r, c]:
                return False
    return True


class FitPoints(NamedTuple):
    """Points to evaluate around a peak (3,), with the scan's log-likelihood there.

    The cube (samples, 3) holds them in standard deviations of a covariance `around` (3, 3); the first is 0.
    """

    peak: FloatArray
    value: float
    around: FloatArray
    cube: FloatArray


@njit
def fit(view: Any, near: Any, prior: Any, spread: Any, tuning: Any, mu: Any, Sigma: Any) -> Any:
    """Fill mu and Sigma by eqs. 15-17 from points around the peak; return log eta."""
    peak, value, around, cube = spread
    # Of Sigma, not of `around`, whose other memory order Numba would compile Cholesky for once more.
    keep(peak, around, mu, Sigma)
    L = np.linalg.cholesky(Sigma)
    n = len(cube)
    at, p = np.empty((n, 3)), np.empty(n)
    top, eta = -np.inf, 0.0
    # Number by number: each array expression Numba would compile as a kernel.
    for j in range(n):
        shift = L @ cube[j]
        for i in range(3):
            at[j, i] = peak[i] + shift[i]
        if j > 0:
            value = score(view, near, at[j], tuning)[0]
        p[j] = value + log_prior(at[j], prior)
        top = max(top, p[j])
    for j in range(n):
        p[j] = np.exp(p[j] - top)
        eta += p[j]
    for a in range(3):
        mu[a] = 0.0
        for j in range(n):
            mu[a] += p[j] / eta * at[j, a]
    # Few points leave Sigma flat in some direction: a share of the curvature's covariance keeps it regular.
    for a in range(3):
        for b in range(3):
            Sigma[a, b] = 0.01 * around[a, b]
            for j in range(n):
                Sigma[a, b] += p[j] / eta * (at[j, a] - mu[a]) * (at[j, b] - mu[b])
    # Each point stands for its share of the volume, which differs from particle to particle.
    return top + np.log(eta / n * L[0, 0] * L[1, 1] * L[2, 2])


@njit
def keep(mean: Any, sigma: Any, to_mean: Any, to_sigma: Any) -> None:
    """Copy a mean (3,) and a covariance (3, 3)."""
    # Not `to_mean[:] = mean`: Numba would compile the message of shapes that differ.
    for i in range(3):
        to_mean[i] = mean[i]
        for j in range(3):
            to_sigma[i, j] = sigma[i, j]
