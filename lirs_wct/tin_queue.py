"""Kernels of the queue of triangles beyond the budget: which is the worst?

Bins of errors that differ by less than one part in 128, each a list linked both ways: putting in, taking
out and finding the worst cost the same however many there are. Of equals the latest is first, whose
neighbourhood is still in the cache.
"""

from __future__ import annotations

import numpy as np

from lirs_wct.tin import TOP, Tin, kernel

_SHIFT = 52 - 7
"""Leaves a float64's exponent and the first seven bits of its fraction."""
_NOWHERE = -1
_FIRST = -2
"""First in bin k: -2 - k stands where the triangle before would."""


def count_bins(least: float, most: float) -> int:
    """Return how many bins errors from `least` to `most` need."""
    low, high = (int(np.float64(x).view(np.int64)) >> _SHIFT for x in (least, most))
    return high - low + 1


@kernel
def order(x: float) -> int:
    """Return the bits of a number that is not negative: they order as it does.

    The largest of integers is found four at a time, which compilers do not dare with floats.
    """
    return int(np.float64(x).view(np.int64))


@kernel
def worst(tin: Tin) -> int:
    """Return a triangle of the highest bin, -1 if all are empty."""
    top = tin.used[TOP]
    while top > 0 and tin.bins[top] < 0:
        top -= 1
    tin.used[TOP] = top
    return int(tin.bins[top])


@kernel
def put(tin: Tin, t: int, error: int, least: int) -> None:
    """Put a triangle into the bin of its error; both errors are of `order`."""
    k = min((error >> _SHIFT) - (least >> _SHIFT), len(tin.bins) - 1)
    after = tin.bins[k]
    tin.bins[k] = t
    tin.queue[2 * t], tin.queue[2 * t + 1] = _FIRST - k, after
    if after >= 0:
        tin.queue[2 * after] = t
    tin.used[TOP] = max(tin.used[TOP], k)


@kernel
def leave_out(tin: Tin, t: int) -> None:
    """Note of a new triangle that it is within the budget."""
    tin.queue[2 * t] = _NOWHERE


@kernel
def take(tin: Tin, t: int) -> None:
    """Take a triangle out of its bin, if it is in one."""
    before, after = tin.queue[2 * t], tin.queue[2 * t + 1]
    if before == _NOWHERE:
        return
    if after >= 0:
        tin.queue[2 * after] = before
    if before >= 0:
        tin.queue[2 * before + 1] = after
    else:
        tin.bins[_FIRST - before] = after
