"""Weights of particles: normalization, effective number, systematic resampling."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray


class UniformSource(Protocol):
    """Source of uniformly distributed numbers, such as a NumPy generator."""

    def random(self) -> float:
        """Return the next number within [0, 1)."""
        ...


def normalize(log_weights: FloatArray) -> FloatArray:
    """Return (n,) weights of sum 1 from their logarithms up to a constant."""
    weights: FloatArray = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()  # type: ignore[no-any-return]


def effective_number(weights: FloatArray) -> float:
    """Return N_eff = 1 / sum w^2 (Grisetti et al. 2007, eq. 20); `weights` (n,) sum to 1."""
    return float(1.0 / np.square(weights).sum())


def systematic_resample(weights: FloatArray, rng: UniformSource) -> IntArray:
    """Return (n,) indices of the surviving particles, each n w times up to rounding.

    One random number moves a comb of n teeth over the cumulative weights (n,).
    """
    n = len(weights)
    comb = (np.arange(n) + rng.random()) / n
    # Rounding may leave the sum a little under 1: the last tooth still belongs to the last particle.
    return np.minimum(np.searchsorted(np.cumsum(weights), comb, side="right"), n - 1).astype(np.int64)
