"""The proposal's kernels: match, sample around the maximum, fit a Gaussian, draw; all particles at once."""

from __future__ import annotations

import numpy as np
from numba import njit

from slam_baselines.likelihood import log_likelihood
from slam_baselines.particle_matching import Prior, between, log_prior, match, moved, score, search
from slam_baselines.patch_kernels import MapView


@njit(cache=True)
def propose(  # type: ignore[no-untyped-def]
    tables,
    corner,
    patches,
    res,
    bound,
    beams,
    expected,
    covariances,
    best,
    cube,
    normals,
    tuning,
    poses,
    means,
    sigmas,
    told,
):
    """Fill poses, means, sigmas, and told (log eta, met, known); return how many wider searches were made."""
    n = len(expected)
    correction = np.zeros(3)
    searches = 0
    total, width = max(beams.weights.sum(), 1e-9), tuning.sigma / res
    for step in range(n):
        k = best if step == 0 else step - 1 if step <= best else step
        view = MapView(tables[k], corner, patches, res, bound)
        prior = Prior(expected[k], np.linalg.inv(covariances[k]))
        start = prior.pose
        if step > 0:
            other = moved(start, correction)
            if score(view, beams, other, tuning) > score(view, beams, start, tuning):
                start = other
        H = np.empty((3, 3))
        peak = match(view, beams, prior, start, tuning, H)
        value, met, known = log_likelihood(
            view, beams, peak, tuning.kernelSize, tuning.lsigma, tuning.sigma / view.resolution
        )
        if tuning.least_beams <= known and met < tuning.poor_score * known:
            searches += 1
            curvature = H.copy()
            other = match(view, beams, prior, search(view, beams, prior, tuning), tuning, H)
            better, there, seen = log_likelihood(view, beams, other, tuning.kernelSize, tuning.lsigma, width)
            if there >= tuning.poor_score * seen and better + log_prior(other, prior) > value + log_prior(
                peak, prior
            ):
                peak, met, known = other, there, seen
            else:
                H = curvature
        if step == 0:
            correction = between(prior.pose, peak)
        if met < max(tuning.minimumScore * known, tuning.least_beams):
            means[k], sigmas[k], told[k, 0] = (
                prior.pose,
                covariances[k],
                score(view, beams, prior.pose, tuning),
            )
        else:
            around = np.linalg.inv(H * (2 * tuning.sigma**2 / tuning.lsigma) + prior.information)
            told[k, 0] = _fit(view, beams, prior, peak, around, cube, tuning, means[k], sigmas[k])
        poses[k] = means[k] + np.linalg.cholesky(sigmas[k]) @ normals[k]
        told[k, 1], told[k, 2] = met / max(known, 1e-9), known / total
    return searches


@njit(cache=True)
def track(view, beams, expected, covariance, tuning):  # type: ignore[no-untyped-def]
    """Return the pose that fits best, and the weights of beams that met a wall and known cells."""
    prior = Prior(expected, np.linalg.inv(covariance))
    pose = match(view, beams, prior, expected, tuning, np.empty((3, 3)))
    _, met, known = log_likelihood(
        view, beams, pose, tuning.kernelSize, tuning.lsigma, tuning.sigma / view.resolution
    )
    return pose, met, known


@njit(cache=True)
def _fit(view, beams, prior, peak, around, cube, tuning, mu, Sigma):  # type: ignore[no-untyped-def]
    """Fill mu and Sigma by eqs. 15-17 from points around the peak; return log eta."""
    L = np.linalg.cholesky(around)
    n = len(cube)
    at, logs = np.empty((n, 3)), np.empty(n)
    for j in range(n):
        at[j] = peak + L @ cube[j]
        logs[j] = score(view, beams, at[j], tuning) + log_prior(at[j], prior)
    top = logs.max()
    p = np.exp(logs - top)
    eta = p.sum()
    mu[:] = 0.0
    for j in range(n):
        mu += p[j] / eta * at[j]
    # Few points leave Sigma flat in some direction: a share of the curvature's covariance keeps it regular.
    Sigma[:] = 0.01 * around
    for j in range(n):
        d = at[j] - mu
        for a in range(3):
            for b in range(3):
                Sigma[a, b] += p[j] / eta * d[a] * d[b]
    # Each point stands for its share of the volume, which differs from particle to particle.
    return top + np.log(eta / n * L[0, 0] * L[1, 1] * L[2, 2])
