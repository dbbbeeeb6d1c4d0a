"""The motion increment, and the bias of the gyro."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu
from slam_baselines.dead_reckoning import MotionConfig
from slam_baselines.gmapping.motion import GYRO, GyroBias, GyroBiasConfig, MotionIncrement, remove_bias

BIAS = math.radians(0.03)


def drive(step: MotionIncrement, rates: list[float], turns: list[float], speed: float) -> None:
    """Feed one reading every 0.1 s; `turns` are what the odometry says, radians a reading."""
    odometry = Pose2(3, 1, 2)
    for i, (rate, turn) in enumerate(zip(rates, turns, strict=True)):
        odometry = odometry @ Pose2(0.1 * speed if i else 0, 0, turn if i else 0)
        step.add_odometry(odometry, Imu(angular_velocity=(0, 0, rate), stamp=0.1 * i), 0.1 * i)


def test_the_bias_is_taken_out_of_a_step() -> None:
    step = MotionIncrement(MotionConfig())
    step.bias = BIAS
    drive(step, [BIAS] * 101, [0.1 * BIAS] * 101, 1.0)
    assert step.seconds == pytest.approx(10)
    assert step.reckoned.pose.yaw == pytest.approx(10 * BIAS)
    np.testing.assert_allclose(step.pose.as_array(), (10, 0, 0), atol=1e-3)


def test_a_robot_that_stands_is_not_turned_by_the_bias() -> None:
    step = MotionIncrement(MotionConfig())
    step.bias = BIAS
    drive(step, [BIAS] * 50, [0.0] * 50, 0.0)
    np.testing.assert_allclose(step.pose.as_array(), 0, atol=1e-9)
    assert step.seconds == 0


def test_the_noise_of_single_readings_cancels_over_the_way() -> None:
    step = MotionIncrement(MotionConfig())
    drive(step, [0.0] * 101, [(-1.0) ** i * 1e-3 for i in range(101)], 1.0)
    assert math.sqrt(step.reckoned.covariance[2, 2]) == pytest.approx(GYRO * math.sqrt(10), rel=0.01)
    doubted = MotionIncrement(MotionConfig())
    drive(doubted, [0.0] * 101, [1e-3] * 101, 1.0)
    assert math.sqrt(doubted.reckoned.covariance[2, 2]) > 0.05


def test_without_a_gyro_the_odometry_is_believed_as_configured() -> None:
    step, motion = MotionIncrement(MotionConfig()), MotionConfig()
    for i in range(11):
        step.add_odometry(Pose2(0.1 * i), None, 0.1 * i)
    expected = motion.rotation_per_meter**2 + motion.rotation_per_second**2
    assert step.reckoned.covariance[2, 2] == pytest.approx(expected, rel=1e-6)
    assert step.seconds == 0


def test_unbiased_undoes_a_constant_turn() -> None:
    # A straight meter in 2 s that the bias bends into an arc.
    bent = Pose2()
    for _ in range(1000):
        bent = bent @ Pose2(0.001, 0, 0.05 * 0.002)
    np.testing.assert_allclose(remove_bias(bent, 0.05, 2.0).as_array(), (1, 0, 0), atol=1e-3)


def test_the_distance_from_dead_reckoning_is_in_standard_deviations() -> None:
    """After 4 m at 5 cm a meter 10 cm of odometry and 5 cm of registration: 11 cm is one."""
    step = MotionIncrement(MotionConfig(translation_per_meter=0.05))
    for k in range(5):
        step.add_odometry(Pose2(float(k)), None, float(k))
    assert step.distance_from(Pose2(4.0)) == pytest.approx(0.0, abs=1e-9)
    assert step.distance_from(Pose2(4.0, 0.112)) == pytest.approx(1.0, rel=0.05)
    assert step.distance_from(Pose2(2.4)) > 10


CONFIG = GyroBiasConfig()


def biased_drive(
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
            known = biased_drive(bias, steps, k)
            errors.append((known.value - bias) / known.deviation)
        assert 0.75 < np.mean(np.square(errors)) < 1.35


def test_a_few_meters_say_little_and_a_drive_says_much() -> None:
    bias = math.radians(0.03)
    first = [abs(biased_drive(0.0, 8, k).value) for k in range(50)]
    assert np.median(first) < CONFIG.gyro_bias_prior / 2
    assert biased_drive(0.0, 8, 0).deviation > 0.8 * CONFIG.gyro_bias_prior
    late = np.array([biased_drive(bias, 2000, k).value for k in range(8)])
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
    known = biased_drive(0.0, 200, 3)
    turned = known.learned(math.radians(20), 1.5)
    assert turned.value == known.value
    on = turned
    for _ in range(100):
        on = on.learned(0.0, 1.5)
    assert abs(on.value - known.value) < CONFIG.gyro_bias_prior / 4
