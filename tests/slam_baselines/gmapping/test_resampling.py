"""Weights and resampling, on a toy whose posterior is known."""

import numpy as np
import pytest

from slam_baselines.gmapping.particles import effective_number, normalize, systematic_resample


def test_effective_number_of_equal_and_of_one() -> None:
    assert effective_number(np.full(30, 1 / 30)) == pytest.approx(30)
    assert effective_number(np.eye(30)[3]) == pytest.approx(1)


def test_weights_survive_huge_differences_of_logarithms() -> None:
    weights = normalize(np.array([-5000.0, -5001.0, -9000.0]))
    np.testing.assert_allclose(weights, [1 / (1 + np.exp(-1)), 1 / (1 + np.e), 0], atol=1e-12)


def test_each_lives_on_in_proportion_to_its_weight() -> None:
    rng = np.random.default_rng(1)
    weights = rng.dirichlet(np.ones(50))
    counts = np.bincount(systematic_resample(weights, rng), minlength=50)
    assert np.all(np.abs(counts - 50 * weights) < 1)


def test_weights_that_sum_a_little_below_one_are_no_error() -> None:
    weights = np.full(10, 0.1 - 1e-12)

    class Late:
        def random(self) -> float:
            return 1 - 1e-16

    assert systematic_resample(weights, Late()).tolist() == [*range(1, 10), 9]  # type: ignore[arg-type]


def test_posterior_of_a_line_is_that_of_the_kalman_filter() -> None:
    """A robot on a line, Gaussian motion and measurement: the exact posterior is a Gaussian."""
    rng = np.random.default_rng(2)
    n, q, r = 20_000, 0.5, 0.8
    x, log_weights = rng.normal(0, 1, n), np.zeros(n)
    mean, variance = 0.0, 1.0
    for z in (1.0, 2.5, 2.0, 4.2):
        x = x + 1 + rng.normal(0, q, n)
        log_weights -= 0.5 * ((z - x) / r) ** 2
        mean, variance = mean + 1, variance + q**2
        gain = variance / (variance + r**2)
        mean, variance = mean + gain * (z - mean), (1 - gain) * variance
        weights = normalize(log_weights)
        if effective_number(weights) < n / 2:
            x, log_weights = x[systematic_resample(weights, rng)], np.zeros(n)
    weights = normalize(log_weights)
    assert weights @ x == pytest.approx(mean, abs=0.02)
    assert weights @ (x - weights @ x) ** 2 == pytest.approx(variance, rel=0.05)
