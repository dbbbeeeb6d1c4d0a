"""Numba's decorator as all kernels here use it."""

from __future__ import annotations

from functools import partial

import numba

njit = partial(numba.njit, no_cfunc_wrapper=True)
"""numba.njit without an entry for C callbacks: nothing here calls it, and it takes 8 % of a compilation."""
