"""The part of a ray between two planes."""

from __future__ import annotations

from lirs_wct.kernels import njit

FAR = 1e300
"""Stands for infinity where a product with 0 must stay a number."""


@njit(cache=True, error_model="numpy", forceinline=True)
def inverse(slope: float) -> float:
    """Return 1 / slope; 0 for a slope so small (1e-14) that it moves no ray by more than rounding does."""
    return 1.0 / slope if abs(slope) > 1e-14 else 0.0


@njit(cache=True, error_model="numpy", forceinline=True)
def clip(o: float, per: float, low: float, high: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the part of [t0, t1] in which low <= o + t / per <= high; empty when it starts after its end.

    `per` is the inverse of the slope, 0 for a slope of 0.
    """
    if per == 0.0:
        return (t0, t1) if low <= o <= high else (1.0, 0.0)
    a, b = (low - o) * per, (high - o) * per
    return max(t0, min(a, b)), min(t1, max(a, b))
