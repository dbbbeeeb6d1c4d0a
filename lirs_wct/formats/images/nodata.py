"""Pixels without a height: values that are declared, usual, or isolated codes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray

USUAL = (-9999.0, -32768.0)
"""Values of unmeasured pixels even where they are not isolated; values beyond `HUGE` likewise."""
HUGE = 1e30
CODES = (999, 9999, 9999.9, 10_000, 32_767, 65_535, 99_999, 1e5, 999_999, 1e6, 2.0**31 - 1, 2.0**32 - 1)
"""Magnitudes of further values that mean "no height" where they are far outside all others."""
HIGHEST = 1e7
"""Magnitude of heights in any unit; isolated values above it mean "no height" as well."""
ISOLATED = 0.1
"""Distance of such a code from all other heights, share of their range."""


def missing_heights(
    values: NDArray[Any], nodata: float | None, *, search: bool
) -> tuple[BoolArray, tuple[float, ...]]:
    """Return the pixels without a height, and the isolated codes among their values.

    Args:
        values: (rows, cols) pixels in the file's unit.
        nodata: declared value of unmeasured pixels.
        search: whether isolated codes count as "no height".
    """
    missing = ~np.isfinite(values) | (np.abs(values) > HUGE)
    for value in (*USUAL, *(() if nodata is None else (np.float64(nodata).astype(values.dtype),))):
        missing |= values == value
    codes: list[float] = []
    while search and (code := _isolated_code(values[~missing])) is not None:
        missing |= values == code
        codes.append(code)
    return missing, tuple(codes)


def _isolated_code(known: NDArray[Any]) -> float | None:
    """Return the lowest or highest height if it is a code far from all others."""
    for edge in (float(known.min()), float(known.max())) if known.size else ():
        if abs(edge) > HIGHEST or any(abs(abs(edge) - code) <= 1e-6 * code for code in CODES):
            rest = known[known != edge]
            if rest.size and np.abs(rest - edge).min() > ISOLATED * np.ptp(rest):
                return edge
    return None
