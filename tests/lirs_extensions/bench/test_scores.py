"""Scores against figures worked out by hand, and the interval against what it promises."""

import numpy as np
import pytest

from lirs_extensions.bench.episode import coverage_area, distance_share, success_by_path_length
from lirs_extensions.bench.results import score_of


def test_spl_is_the_shortest_way_over_the_driven_one() -> None:
    assert success_by_path_length(True, 6.0, 8.0) == pytest.approx(0.75)
    assert success_by_path_length(True, 6.0, 5.8) == 1.0  # cells make the shortest way a little long
    assert success_by_path_length(False, 6.0, 6.0) == 0.0


def test_coverage_area_of_a_ramp() -> None:
    # 0.15 at first; at 10 of 40 m all of what is wanted (0.95): half of 10 m, then 30 m in full.
    assert coverage_area([0.0, 10.0], [0.15, 0.95], 40.0) == pytest.approx(35 / 40)
    # Half of it at 20 m, and nothing after.
    assert coverage_area([0.0, 20.0], [0.15, 0.55], 40.0) == pytest.approx((5 + 10) / 40)

    # Ground that is seen without driving counts from the start; driving beyond the budget does not.
    assert coverage_area([0.0, 0.0], [0.15, 0.55], 40.0) == pytest.approx(0.5)

    assert coverage_area([0.0, 10.0, 40.0], [0.15, 0.15, 0.15], 40.0) == 0.0
    assert coverage_area([0.0, 40.0, 41.0], [0.15, 0.15, 0.95], 40.0) == pytest.approx(0.0, abs=1e-12)

    assert coverage_area([0.0, 0.0, 0.0], [0.3, 0.3, 0.3], 10.0) == 0.0


def test_distance_share_is_within_0_and_1() -> None:
    assert distance_share(5.0, 20.0) == 0.25
    assert distance_share(-3.0, 20.0) == 0.0
    assert distance_share(21.0, 20.0) == 1.0


def test_a_score_has_an_interval_that_is_the_same_each_time() -> None:
    values = np.random.default_rng(3).random(40).tolist()
    score = score_of(values)
    assert score is not None
    assert score == score_of(values)
    assert score.low is not None
    assert score.high is not None
    assert score.low < score.mean < score.high
    # The normal approximation of the bootstrap's width.
    assert score.high - score.low == pytest.approx(2 * 1.96 * np.std(values) / np.sqrt(40), rel=0.1)


def test_scores_of_one_and_of_equal_tasks() -> None:
    assert score_of([]) is None
    one, equal = score_of([0.4]), score_of([0.0, 0.0])
    assert one is not None
    assert (one.low, one.count) == (None, 1)
    assert equal is not None
    assert (equal.low, equal.high) == (0.0, 0.0)


def test_the_interval_covers_the_mean_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(60):
        score = score_of((rng.random(30) < 0.6).astype(float).tolist())
        assert score is not None
        assert score.low is not None
        assert score.high is not None
        covered += score.low <= 0.6 <= score.high
    assert covered >= 50
