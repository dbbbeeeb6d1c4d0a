"""Failures of a path and the alarms that report them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_validation.metrics.failure import SOON, compare_alarms, window_errors
from lirs_validation.metrics.trajectory import rigid_alignment, rms
from lirs_wct import BoolArray

STAMPS = np.arange(0.0, 60.0, 0.1)


def at(*spans: tuple[float, float]) -> BoolArray:
    """Return whether each stamp lies in one of the spans."""
    found = np.zeros(len(STAMPS), bool)
    for low, high in spans:
        found |= (low <= STAMPS) & (high > STAMPS)
    return found


@given(st.integers(0, 1000), st.floats(0.5, 20.0))
@settings(max_examples=20, deadline=None)
def test_window_errors_are_those_of_each_window_aligned_alone(seed: int, length: float) -> None:
    rng = np.random.default_rng(seed)
    true = np.cumsum(rng.normal(0.1, 0.2, (80, 2)), axis=0) + 1000.0
    estimate = true @ np.array(((0.0, 1.0), (-1.0, 0.0))) + np.cumsum(
        rng.normal(0.0, 0.05, true.shape), axis=0
    )
    driven = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(true, axis=0), axis=1)))
    found = window_errors(true, estimate, length)
    for k in (5, 30, 79):
        first = np.flatnonzero(driven <= max(0.0, driven[k] - length))[-1]
        a, b = estimate[first : k + 1], true[first : k + 1]
        expected = (
            rms(np.linalg.norm(rigid_alignment(a, b).apply(a) - b, axis=1)) if driven[k] >= 1 else math.nan
        )
        assert found[k] == pytest.approx(expected, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize(
    ("alarm", "noticed", "delay", "false"),
    [
        (at(), False, None, 0),
        (at((33.1, 40)), True, 3.1, 0),
        (at((27.0, 27.5)), True, -3.0, 0),
        (at((10, 40)), True, -5.0, 1),  # on for long: false when it began
        (at((10, 11), (15, 16), (50, 51)), False, 20.0, 2),
        (at((59.0, 60)), False, 29.0, 0),
    ],
)
def test_alarms_are_compared_with_the_failure(
    alarm: BoolArray, noticed: bool, delay: float | None, false: int
) -> None:
    found = compare_alarms(STAMPS, at((30, 60)), alarm, 30.0)
    assert (found.noticed, found.false) == (noticed, false)
    assert found.delay == (None if delay is None else pytest.approx(delay))
    assert found.healthy == pytest.approx(30.0 - SOON, abs=0.15)
    assert found.false_per_hour == pytest.approx(3600 * false / found.healthy)


def test_a_path_that_is_not_lost_has_false_alarms_only_where_no_pose_fails() -> None:
    found = compare_alarms(STAMPS, at((28, 29)), at((10, 11), (30, 31), (50, 51)), None)
    assert (found.noticed, found.delay, found.false) == (None, None, 2)
