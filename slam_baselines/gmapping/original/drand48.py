"""Random numbers of the original: the C library's drand48, and normal numbers.

The original draws everything from this one stream, so the same seed gives the same trajectory here and there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.kernels import njit

MULTIPLIER, INCREMENT, MASK = np.uint64(0x5DEECE66D), np.uint64(0xB), np.uint64((1 << 48) - 1)
"""Of the linear congruential generator (POSIX)."""
LOW = 0x330E
"""The low 16 bits of a seeded state (POSIX); the seed's 32 bits are above."""


class Drand48:
    """A stream of random numbers."""

    def __init__(self, seed: int) -> None:
        """Start as `srand48(seed)` does."""
        self._state = np.array([((seed & 0xFFFFFFFF) << 16) + LOW], np.uint64)

    def random(self) -> float:
        """Return the next number of the uniform distribution over [0, 1)."""
        return float(_uniform(self._state))

    def standard_normal(self, shape: tuple[int, ...]) -> FloatArray:
        """Return the next numbers of the standard normal distribution, in row order."""
        out = np.empty(shape)
        _fill_normal(self._state, out.reshape(-1))
        return out


@njit(cache=True, nogil=True)
def _uniform(state: Any) -> Any:
    state[0] = (state[0] * MULTIPLIER + INCREMENT) & MASK
    return np.float64(state[0]) / 281474976710656.0  # 2^48


@njit(cache=True, nogil=True)
def _fill_normal(state: Any, out: Any) -> None:
    """Fill `out` by Marsaglia's polar method; like the original, skip every second number."""
    for k in range(len(out)):
        while True:
            x = 2 * _uniform(state) - 1
            _uniform(state)
            y = 2 * _uniform(state) - 1
            w = x * x + y * y
            if 0 < w <= 1:
                break
        out[k] = y * np.sqrt(-2 * np.log(w) / w)
