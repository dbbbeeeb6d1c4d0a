"""Sequential test: bounds, error rates on random streams, and the exact interval."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import binomtest

from lirs_extensions.decide.decide import P0, P1, SequentialTest


def outcome_of_stream(share: float, rng: np.random.Generator) -> tuple[str, int]:
    test, count = SequentialTest(), 0
    while test.outcome is None:
        success, count = bool(rng.random() < share), count + 1
        test = SequentialTest(test.successes + success, test.failures + (not success))
    return test.outcome, count


@pytest.mark.parametrize(("share", "wrong"), [(P0, "accepted"), (P1, "rejected")])
def test_at_most_five_percent_of_random_streams_are_decided_wrongly(share: float, wrong: str) -> None:
    rng = np.random.default_rng(1)
    outcomes = [outcome_of_stream(share, rng)[0] for _ in range(3000)]
    assert outcomes.count(wrong) / len(outcomes) < 0.06


def test_ten_successes_or_three_failures_in_a_row_decide() -> None:
    assert SequentialTest(9, 0).outcome is None
    assert SequentialTest(10, 0).outcome == "accepted"
    assert SequentialTest(0, 2).outcome is None
    assert SequentialTest(0, 3).outcome == "rejected"


@given(st.integers(0, 30), st.integers(0, 10))
def test_fewer_observations_than_least_more_never_decide(successes: int, failures: int) -> None:
    test = SequentialTest(successes, failures)
    least = test.least_more
    if test.outcome is not None:
        assert least == 0
        return
    ahead = [SequentialTest(successes + k, failures + n - k) for n in range(least) for k in range(n + 1)]
    assert all(state.outcome is None for state in ahead)
    ends = SequentialTest(successes + least, failures), SequentialTest(successes, failures + least)
    assert any(state.outcome is not None for state in ends)


@given(st.integers(0, 40), st.integers(0, 40))
def test_the_interval_is_that_of_scipy(successes: int, failures: int) -> None:
    if successes + failures == 0:
        assert SequentialTest().interval == (0.0, 1.0)
        assert SequentialTest().share is None
        return
    expected = binomtest(successes, successes + failures).proportion_ci(0.95, method="exact")
    assert SequentialTest(successes, failures).interval == pytest.approx((expected.low, expected.high))
