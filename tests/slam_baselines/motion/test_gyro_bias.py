"""A gyro's bias: as well known as the filter says, never far beyond the data sheet, learned all the way."""

import math

import numpy as np
from hypothesis import given, settings, strategies as st

from slam_baselines.gmapping.increment import GyroBias, GyroBiasConfig

CONFIG = GyroBiasConfig()


def drive(
    bias: float, steps: int, seed: int, *, seconds: float = 1.5, heading: float | None = None
) -> GyroBias:
    """Registered headings with white noise on a walk, as the filter assumes; a bias turns the gyro."""
    rng, known = np.random.default_rng(seed), GyroBias.unknown(CONFIG)
    sigma = CONFIG.heading_error if heading is None else heading
    walk = np.cumsum(rng.normal(0, CONFIG.heading_walk * math.sqrt(seconds), steps))
    disagreement = walk - bias * seconds * np.arange(1, steps + 1) + rng.normal(0, sigma, steps)
    for step in np.diff(disagreement, prepend=0.0).tolist():
        known = known.learned(step, seconds)
    return known


def test_the_filter_knows_how_well_it_knows() -> None:
    """Normalized errors of 200 gyros of the data sheet: mean square 1 (Bar-Shalom et al. 2001, 5.4)."""
    rng = np.random.default_rng(1)
    for steps in (5, 30, 100):
        errors = []
        for k in range(200):
            bias = rng.normal(0, CONFIG.gyro_bias_prior)
            known = drive(bias, steps, k)
            errors.append((known.value - bias) / known.deviation)
        assert 0.75 < np.mean(np.square(errors)) < 1.35


def test_a_few_meters_say_little_and_a_drive_says_much() -> None:
    bias = math.radians(0.03)
    first = [abs(drive(0.0, 8, k).value) for k in range(50)]
    assert np.median(first) < CONFIG.gyro_bias_prior / 2
    assert drive(0.0, 8, 0).deviation > 0.8 * CONFIG.gyro_bias_prior
    late = np.array([drive(bias, 2000, k).value for k in range(8)])
    assert np.abs(late - bias).mean() < CONFIG.gyro_bias_prior / 4


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(-3.2, 3.2), st.floats(1e-3, 30.0)), max_size=200))
def test_the_covariance_stays_positive_and_bounded(steps: list[tuple[float, float]]) -> None:
    known, before = GyroBias.unknown(CONFIG), CONFIG.gyro_bias_prior
    for disagreement, seconds in steps:
        known = known.learned(disagreement, seconds)
        assert np.linalg.eigvalsh(known.covariance).min() > 0
        np.testing.assert_allclose(known.covariance, known.covariance.T, rtol=1e-9)
        assert known.deviation <= math.hypot(before, CONFIG.gyro_bias_drift * math.sqrt(seconds)) * (1 + 1e-9)
        before = known.deviation


def test_a_map_that_was_turned_is_no_bias() -> None:
    known = drive(0.0, 200, 3)
    turned = known.learned(math.radians(20), 1.5)
    assert turned.value == known.value
    on = turned
    for _ in range(100):
        on = on.learned(0.0, 1.5)
    assert abs(on.value - known.value) < CONFIG.gyro_bias_prior / 4
