"""Shrinking on synthetic objectives."""

import numpy as np
from hypothesis import given, settings, strategies as st

from lirs_extensions.search.case_search import Case, shrink
from lirs_extensions.search.falsify.search import PARAMETERS, SearchLimits

LIMITS = SearchLimits()
NAMES = [p.name for p in PARAMETERS]


def distance(case: Case, name: str) -> float:
    """Return the distance of a value from its default, share of the limits."""
    parameter = next(p for p in PARAMETERS if p.name == name)
    return abs(case.values[name] - parameter.default) / (parameter.high - parameter.low)


@settings(max_examples=60, deadline=None)
@given(st.sets(st.sampled_from(NAMES), min_size=1, max_size=4), st.integers(0, 1000))
def test_the_cause_alone_remains(cause: set[str], seed: int) -> None:
    case = LIMITS.case(np.random.default_rng(seed).random(len(LIMITS.free)))
    needed = {name: 0.5 * distance(case, name) for name in cause}

    def fails(tried: Case) -> bool:
        return all(distance(tried, name) >= least for name, least in needed.items())

    trail = shrink(case, LIMITS, fails)
    assert all(fails(tried) for tried in trail)
    changed = {p.name for p in LIMITS.difference(trail[-1])}
    assert changed <= {name for name in cause if distance(case, name) > 0}
    assert all(distance(trail[-1], name) <= distance(case, name) + 1e-9 for name in changed)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**16), st.integers(1, 12))
def test_no_single_parameter_of_the_result_can_be_reset(seed: int, threshold: int) -> None:
    """Failures that are not monotone: any of several weighted sums above a limit."""
    rng = np.random.default_rng(seed)
    weights = rng.normal(size=(3, len(NAMES)))
    case = LIMITS.case(rng.random(len(LIMITS.free)))

    def total(tried: Case) -> float:
        shares = np.array([distance(tried, name) for name in NAMES])
        return float((weights @ shares).max())

    limit = total(case) * threshold / 12 if total(case) > 0 else total(case)
    asked: list[Case] = []

    def fails(tried: Case) -> bool:
        asked.append(tried)
        return total(tried) >= limit

    last = shrink(case, LIMITS, fails)[-1]
    for parameter in LIMITS.difference(last):
        assert not fails(last.with_value(parameter.name, float(parameter.default)))
    keys = [tuple(sorted(tried.values.items())) for tried in asked[: -len(LIMITS.difference(last)) or None]]
    assert len(keys) == len(set(keys))


def test_a_failure_of_the_easiest_case_has_no_cause() -> None:
    case = LIMITS.case(np.full(len(LIMITS.free), 0.5))
    assert shrink(case, LIMITS, lambda tried: True)[-1] == LIMITS.easiest


def test_values_move_towards_the_threshold() -> None:
    case = LIMITS.easiest.with_value("slope", 14.0)
    last = shrink(case, LIMITS, lambda tried: tried.values["slope"] >= 4.0)[-1]
    assert 4.0 <= last.values["slope"] < 6.0
