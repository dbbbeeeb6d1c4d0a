"""Weights of particles: the effective number of them, and systematic resampling."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray


class UniformSource(Protocol):
    """What draws numbers of the uniform distribution, as a NumPy generator does."""

    def random(self) -> float:
        """Return the next number within [0, 1)."""
        ...


def normalize(log_weights: FloatArray) -> FloatArray:
    """Return (n,) weights that sum to 1, of logarithms up to a constant."""
    weights: FloatArray = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()  # type: ignore[no-any-return]


def effective_number(weights: FloatArray) -> float:
    """Return N_eff = 1 / sum w^2 (Grisetti et al. 2007, eq. 20); `weights` (n,) sum to 1."""
    return float(1.0 / np.square(weights).sum())


def systematic_resample(weights: FloatArray, rng: UniformSource) -> IntArray:
    """Return (n,) indices of the particles that live on, each n w times, up to one more or less.

    One random number moves a comb of n teeth over the cumulative weights (n,).
    """
    n = len(weights)
    comb = (np.arange(n) + rng.random()) / n
    # Rounding may leave the sum a little under 1: the last tooth still belongs to the last particle.
    return np.minimum(np.searchsorted(np.cumsum(weights), comb, side="right"), n - 1).astype(np.int64)
