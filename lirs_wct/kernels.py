"""Numba decorator of all kernels."""

from __future__ import annotations

from functools import partial

import numba

njit = partial(numba.njit, no_cfunc_wrapper=True, error_model="numpy")
"""numba.njit with NumPy's division by zero, without the entry for C callbacks, 8 % of a compilation."""
