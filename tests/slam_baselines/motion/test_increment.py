"""The motion increment: gyro, odometry and the gyro's bias."""

import math

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu
from slam_baselines.dead_reckoning import MotionConfig
from slam_baselines.gmapping.increment import GYRO, MotionIncrement, remove_bias

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
