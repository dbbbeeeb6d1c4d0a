"""The Gaussian of the proposal: fitted to the posterior at points around the scan's peak.

Grisetti, Stachniss, Burgard 2007, eqs. 15-17; see `proposal`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.kernels import njit
from slam_baselines.gmapping.scan_matching import log_prior, score


class Spread(NamedTuple):
    """Points to evaluate.

    Attributes:
        peak: (3,) x, y, yaw, the first of them.
        value: log-likelihood of the scan there.
        around: (3, 3) covariance.
        cube: (samples, 3) the points in standard deviations from the peak; the first is 0.
    """

    peak: FloatArray
    value: float
    around: FloatArray
    cube: FloatArray


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def keep(mean: Any, sigma: Any, to_mean: Any, to_sigma: Any) -> None:
    """Copy a mean (3,) and a covariance (3, 3)."""
    # Not `to_mean[:] = mean`: Numba would compile the message of shapes that differ.
    for i in range(3):
        to_mean[i] = mean[i]
        for j in range(3):
            to_sigma[i, j] = sigma[i, j]
