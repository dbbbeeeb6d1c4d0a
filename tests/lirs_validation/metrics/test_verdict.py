"""One rule says whether a place was lost, and one whether a trajectory leaves out scans."""

from collections.abc import Iterable

import pytest

from lirs_validation.metrics.verdict import (
    LostRule,
    incompleteness,
    inconsistency,
    is_worse,
    revisit_agreement,
)


def judged(flags: Iterable[bool], period: float = 0.1) -> str | None:
    rule = LostRule()
    for k, lost in enumerate(flags):
        rule.observe(k * period, lost)
    return rule.reason()


def test_a_short_loss_is_forgiven() -> None:
    assert judged([False] * 500 + [True] * 20 + [False] * 500) is None
    assert judged([]) is None


def test_five_seconds_in_a_row_are_a_loss_even_where_it_is_found_again() -> None:
    lost = judged([False] * 5000 + [True] * 51 + [False] * 5000)
    assert "at 500.0 s for 5.0 s" in lost
    assert "51 of 10051 scans" in lost
    assert judged([False] * 5000 + [True] * 50 + [False] * 5000) is None  # 4.9 s


def test_the_share_counts_where_no_loss_is_long() -> None:
    """756 of 2,008 scans of a log were lost, the last was not, and it was told as ok."""
    lost = judged(([False] * 5 + [True] * 3) * 251)
    assert "753 of 2008 scans (37.5 %)" in lost
    assert judged(([False] * 97 + [True] * 5) * 20) is None


def test_a_few_scans_far_apart_are_no_loss() -> None:
    """A scan a meter: three of them last as long as 150 of a lidar at 25 Hz."""
    assert judged([False] * 300 + [True] * 3 + [False] * 37, period=3.0) is None
    assert judged([False] * 300 + [True] * 10 + [False] * 37, period=3.0) is not None


@pytest.mark.parametrize(("coverage", "complete"), [(1.0, True), (0.95, True), (0.9499, False), (0.0, False)])
def test_a_trajectory_needs_a_pose_for_95_percent_of_the_scans(coverage: float, complete: bool) -> None:
    lacking = incompleteness(coverage)
    assert (lacking is None) == complete
    if lacking is not None:
        assert "at least 95 % are required" in lacking


def test_up_to_5_percent_of_the_scans_may_contradict_other_passes() -> None:
    assert inconsistency(None) is None
    assert inconsistency(0.05) is None
    assert "5.1 % of the scans" in (inconsistency(0.051) or "")


@pytest.mark.parametrize(
    ("residual", "words"),
    [
        (0.25, "the passes agree"),
        (0.251, "the passes agree in part"),
        (0.4, "the passes agree in part"),
        (0.401, "the passes disagree"),
    ],
)
def test_passes_agree_up_to_a_residual(residual: float, words: str) -> None:
    assert revisit_agreement(residual) == words


@pytest.mark.parametrize(
    ("ate", "odometry", "worse"),
    [(0.1006, 0.1, True), (0.1004, 0.1, False), (0.05, 0.1, False), (None, 0.1, False), (0.1, None, False)],
)
def test_an_error_is_worse_when_it_is_visibly_larger(
    ate: float | None, odometry: float | None, worse: bool
) -> None:
    assert is_worse(ate, odometry) == worse
