"""What repeats of one experiment say together: mean, spread, and how sure the mean is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """Mean over repeats with its confidence interval.

    Attributes:
        mean: of the values.
        std: standard deviation of the sample (n - 1); None of one value.
        half_width: of the mean's 95 % interval, from Student's t; None of one value.
        count: how many values there are.
    """

    mean: float
    std: float | None
    half_width: float | None
    count: int


def repeats(values: Sequence[float]) -> Repeats | None:
    """Return mean, standard deviation and 95 % interval of repeats; None of no value."""
    n = len(values)
    if n == 0:
        return None
    mean = float(np.mean(values))
    if n == 1:
        return Repeats(mean=mean, std=None, half_width=None, count=1)
    std = float(np.std(values, ddof=1))
    reach = float(stats.t.ppf(0.5 + CONFIDENCE / 2, n - 1)) * std / math.sqrt(n)
    return Repeats(mean=mean, std=std, half_width=reach, count=n)
