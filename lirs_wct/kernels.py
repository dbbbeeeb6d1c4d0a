"""Numba decorator of all kernels."""

from __future__ import annotations

from functools import partial

import numba

njit = partial(numba.njit, cache=True, nogil=True, no_cfunc_wrapper=True, error_model="numpy")
"""numba.njit with common options: with others, Numba would compile what two kernels call twice."""
