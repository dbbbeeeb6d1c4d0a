"""Groups of runs that differ in their seed alone, and statistical comparison of two results.

Runs are paired by group and seed: both of a pair had the same world, tour and noise, so that only the
change under test can differ. Per group and metric the mean of the paired differences gets its 95 %
confidence interval and a two-sided p value; all p values of a comparison are corrected together after Holm,
"A Simple Sequentially Rejective Multiple Test Procedure" (Scandinavian Journal of Statistics, 1979).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy  # its modules load on first use

from lirs_validation.record.metric_catalog import Entry, Metric
from lirs_validation.record.run_record import FIELDS, RunGroup, by_group, succeeded
from lirs_wct import ConfigError, FloatArray, require_known

ORIGINAL = "_original"
"""End of the name of a method as published: `hector_original` beside `hector`."""
CONFIDENCE = 0.95
"""Share of the confidence intervals."""
Test = Literal["t", "Wilcoxon", "sign", "none"]
UNTESTED: tuple[Test, None, None, None] = ("none", None, None, None)
LEVEL = 0.05
"""A difference is significant where its corrected p value is below this."""
MIN_RANKED = 10
"""Number of pairs from which on differences that are plainly not normal are ranked instead."""
NOT_NORMAL = 0.01
"""P value of Shapiro's and Wilk's test below which differences are plainly not normal."""


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """Mean over repeats with its confidence interval.

    Attributes:
        mean: Mean of the values.
        std: Standard deviation of the sample (n - 1); None of one value.
        half_width: Half width of the mean's 95 % interval, from Student's t; None of one value.
        count: Number of values.
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


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference of a group's metric between two results, b minus a, over common seeds.

    Attributes:
        group: Group of runs.
        metric: Compared metric; all values are in its unit.
        a: Mean in the first result.
        b: Mean in the second result.
        difference: Mean of the paired differences, with its 95 % interval `low` to `high`; None of one pair.
        pairs: Number of seeds with the metric in both results.
        seeds: Number of seeds in which both runs succeeded, with the metric or without.
        test: Paired t; Wilcoxon's signed ranks where the differences are plainly not normal (the interval is
            then bootstrapped); the sign test where all are the same; none of one pair, or
            where a metric is not tested.
        p: Two-sided p value of the test; None without a test.
        p_corrected: P value after Holm's correction over all tests of the comparison.
    """

    group: RunGroup
    metric: Metric
    a: float
    b: float
    difference: float
    low: float | None
    high: float | None
    pairs: int
    seeds: int
    test: Test
    p: float | None
    p_corrected: float | None = None

    @property
    def significant(self) -> bool | None:
        """Whether the difference is statistically significant (Holm); None without a test."""
        return None if self.p_corrected is None else self.p_corrected < LEVEL


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All differences of two results, and the groups that only one of them has.

    `common` holds the runs of each common group of both results, failed ones included.
    """

    differences: tuple[Difference, ...]
    only_a: tuple[RunGroup, ...]
    only_b: tuple[RunGroup, ...]
    common: dict[RunGroup, tuple[Sequence[Entry], Sequence[Entry]]]


def compare(
    a: Sequence[Entry], b: Sequence[Entry], metrics: Sequence[Metric], across: Sequence[str] = ()
) -> Comparison:
    """Compare the runs of two results that succeeded, by group and seed.

    The results may differ in the fields of a group in `across`, such as `mapper`.
    """
    for field in across:
        require_known("field of a group", field, FIELDS)
    runs_a, runs_b = by_shared(a, across), by_shared(b, across)
    common = [group for group in runs_a if group in runs_b]
    if not common:
        raise ConfigError(_nothing_common(list(by_group(a)), list(by_group(b))))
    found = [
        difference
        for group in common
        for metric in metrics
        if (difference := _difference(group, metric, runs_a[group], runs_b[group])) is not None
    ]
    corrected = iter(holm(np.array([d.p for d in found if d.p is not None])).tolist())
    return Comparison(
        differences=tuple(d if d.p is None else replace(d, p_corrected=next(corrected)) for d in found),
        only_a=tuple(group for group in runs_a if group not in runs_b),
        only_b=tuple(group for group in runs_b if group not in runs_a),
        common={group: (list(runs_a[group].values()), list(runs_b[group].values())) for group in common},
    )


def by_shared(entries: Sequence[Entry], across: Sequence[str]) -> dict[RunGroup, dict[int, Entry]]:
    """Return the runs of each group by seed, with the fields in `across` ignored."""
    placeholders = {name: 0.0 if name == "seconds" else "*" for name in across}
    groups: dict[RunGroup, dict[int, Entry]] = {}
    for entry in entries:
        own, seed = RunGroup.of(entry), int(entry["seed"])
        runs = groups.setdefault(own.replaced(**placeholders), {})
        if seed in runs:
            other = RunGroup.of(runs[seed])
            both = (
                f"one result holds two runs of one group and seed, {runs[seed]['name']} and {entry['name']}"
            )
            differing = [f for f in FIELDS if f in across and own[f] != other[f]]
            if not differing:
                raise ConfigError(f"{both}: move one of them to another folder")
            values = ", ".join(f"{f} ({other[f]} and {own[f]})" for f in differing)
            choice = " ".join(f"{f}={other[f]}" for f in differing)
            raise ConfigError(f"{both}; they differ in {values}: choose one as FOLDER:{choice}")
        runs[seed] = entry
    return groups


def _difference(
    group: RunGroup, metric: Metric, a: dict[int, Entry], b: dict[int, Entry]
) -> Difference | None:
    """Compare one metric over seeds with two successful runs; None without values."""
    seeds = [seed for seed in sorted(set(a) & set(b)) if succeeded(a[seed]) and succeeded(b[seed])]
    values = [
        (x, y)
        for seed in seeds
        if (x := metric.comparable(a[seed])) is not None and (y := metric.comparable(b[seed])) is not None
    ]
    if not values:
        return None
    x, y = np.array(values).T
    test, p, low, high = paired_test(y - x) if metric.tested else UNTESTED
    return Difference(
        group=group,
        metric=metric,
        a=float(x.mean()),
        b=float(y.mean()),
        difference=float((y - x).mean()),
        low=low,
        high=high,
        pairs=len(values),
        seeds=len(seeds),
        test=test,
        p=p,
    )


def paired_test(d: FloatArray) -> tuple[Test, float | None, float | None, float | None]:
    """Test paired differences (n,); return test, p value and 95 % interval of the mean."""
    found = repeats(d.tolist())
    if found is None or found.half_width is None:
        return "none", None, None, None
    low, high = found.mean - found.half_width, found.mean + found.half_width
    if np.ptp(d) <= 1e-12 * max(1.0, float(np.abs(d).max())):
        # Without spread there is no t test, only the common sign.
        return "sign", 1.0 if abs(found.mean) <= 1e-12 else 2.0 ** (1 - len(d)), low, high
    if len(d) >= MIN_RANKED and float(scipy.stats.shapiro(d).pvalue) < NOT_NORMAL:
        interval = scipy.stats.bootstrap(
            (d,), np.mean, confidence_level=CONFIDENCE, rng=np.random.default_rng(0)
        ).confidence_interval
        return "Wilcoxon", float(scipy.stats.wilcoxon(d).pvalue), float(interval.low), float(interval.high)
    return "t", float(scipy.stats.ttest_1samp(d, 0.0).pvalue), low, high


def least_effect(pairs: int, tests: int) -> float:
    """Return the smallest mean difference, in deviations, that one of several tests finds."""
    critical = scipy.stats.t.isf(LEVEL / (2 * tests), pairs - 1) if pairs > 1 else math.inf
    return float(critical) / math.sqrt(pairs)


def holm(p: FloatArray) -> FloatArray:
    """Correct p values (n,) after Holm: the k-th smallest times n - k + 1."""
    order = np.argsort(p, kind="stable")
    raised = p[order] * np.arange(len(p), 0, -1)
    result = np.empty_like(p)
    result[order] = np.minimum(np.maximum.accumulate(raised), 1.0)
    return result


def only(entries: Sequence[Entry], fields: Mapping[str, str]) -> list[Entry]:
    """Return the records whose groups have the given values, such as `mapper` = `hector`."""
    for field, value in fields.items():
        require_known("field of a group", field, FIELDS)
        there = {_text(RunGroup.of(entry), field) for entry in entries}
        require_known(field, value, there)
    return [e for e in entries if all(_text(RunGroup.of(e), f) == value for f, value in fields.items())]


def _text(group: RunGroup, field: str) -> str:
    value = group[field]
    return f"{value:g}" if isinstance(value, float) else str(value)


def _nothing_common(a: Sequence[RunGroup], b: Sequence[RunGroup]) -> str:
    """Return the message for two results without a common group."""
    apart = [f for f in FIELDS if not {group[f] for group in a} & {group[f] for group in b}]
    differing = ", ".join(
        f"{f} ({'/'.join(sorted({str(c[f]) for c in a}))} and {'/'.join(sorted({str(c[f]) for c in b}))})"
        for f in apart
    )
    if not apart:
        return f"the results have no group in common ({', '.join(FIELDS)})"
    pairing = f"--across {','.join(apart)} pairs them"
    return f"the results have no group in common: they differ in {differing}; {pairing}"
