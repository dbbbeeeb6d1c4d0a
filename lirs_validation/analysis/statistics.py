"""Statistics of repeats: mean, spread, confidence intervals and paired tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy  # its modules load on first use

from lirs_wct.arrays import FloatArray

CONFIDENCE = 0.95
RANKED = 10
"""From so many pairs on, differences that are plainly not normal are ranked instead."""
PLAINLY = 0.01
"""P value of Shapiro's and Wilk's test below which differences are plainly not normal."""

Test = Literal["t", "Wilcoxon", "sign", "none"]


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
    reach = float(scipy.stats.t.ppf(0.5 + CONFIDENCE / 2, n - 1)) * std / math.sqrt(n)
    return Repeats(mean=mean, std=std, half_width=reach, count=n)


def paired_test(d: FloatArray) -> tuple[Test, float | None, float | None, float | None]:
    """Test paired differences (n,); return test, p value and 95 % interval of the mean."""
    found = repeats(d.tolist())
    if found is None or found.half_width is None:
        return "none", None, None, None
    low, high = found.mean - found.half_width, found.mean + found.half_width
    if np.ptp(d) <= 1e-12 * max(1.0, float(np.abs(d).max())):
        # Without spread there is no t test, only the common sign.
        return "sign", 1.0 if abs(found.mean) <= 1e-12 else 2.0 ** (1 - len(d)), low, high
    if len(d) >= RANKED and float(scipy.stats.shapiro(d).pvalue) < PLAINLY:
        interval = scipy.stats.bootstrap(
            (d,), np.mean, confidence_level=CONFIDENCE, rng=np.random.default_rng(0)
        ).confidence_interval
        return "Wilcoxon", float(scipy.stats.wilcoxon(d).pvalue), float(interval.low), float(interval.high)
    return "t", float(scipy.stats.ttest_1samp(d, 0.0).pvalue), low, high


def holm(p: FloatArray) -> FloatArray:
    """Correct p values (n,) after Holm.

    The k-th smallest is multiplied by n - k + 1; the results never decrease.
    """
    order = np.argsort(p, kind="stable")
    raised = p[order] * np.arange(len(p), 0, -1)
    result = np.empty_like(p)
    result[order] = np.minimum(np.maximum.accumulate(raised), 1.0)
    return result
