"""Numba decorator of all kernels."""

from __future__ import annotations

from functools import partial

import numba

njit = partial(numba.njit, no_cfunc_wrapper=True)
"""numba.njit without the entry for C callbacks, which is unused and takes 8 % of a compilation."""
