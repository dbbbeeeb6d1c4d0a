"""Dead reckoning: steps at once, systematic errors of the odometry, heights in space."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu
from slam_baselines.dead_reckoning import (
    Calibration,
    CalibrationConfig,
    DeadReckoning,
    MotionConfig,
    PoseEstimate,
    climb,
    spatial_odometry,
)

ANGLE = st.floats(-math.pi, math.pi)
STEPS = st.lists(
    st.tuples(st.builds(Pose2, st.floats(-2, 2), st.floats(-1, 1), ANGLE), st.floats(0, 0.5)),
    min_size=1,
    max_size=30,
)


@given(st.builds(Pose2, st.floats(-50, 50), st.floats(-50, 50), ANGLE), STEPS, st.floats(0, 0.5))
@settings(max_examples=60, deadline=None)
def test_steps_at_once_are_steps_one_after_the_other(
    start: Pose2, steps: list[tuple[Pose2, float]], seconds: float
) -> None:
    config, A = MotionConfig(), np.array(((0.2, 0.1, 0.02), (0.1, 0.3, -0.1), (0.02, -0.1, 0.4)))
    before = PoseEstimate(start, A @ A.T)
    expected = before
    for step, tilt in steps:
        expected = config.step(step, seconds, step.yaw, tilt).after(expected)
    found = config.predict_all(before, steps, seconds)
    assert found.pose == expected.pose
    np.testing.assert_array_equal(found.covariance, expected.covariance)


@settings(max_examples=25, deadline=None)
@given(
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.floats(-0.03, 0.03),
    st.floats(-3, 3),
    st.integers(0, 99),
)
def test_constant_errors_are_learnt(
    meter: float, lateral: float, turn: float, slide: float, seed: int
) -> None:
    rng, calibration = np.random.default_rng(seed), Calibration(CalibrationConfig())
    for _ in range(1500):
        d, a, east, north = (rng.uniform(0, 0.05), rng.normal(0, 0.03), *rng.normal(0, 0.15, 2))
        step, down = Pose2(d, 0.0, a), (east, north)
        true = Pose2(
            d * (1 + meter) + slide * abs(a) * east, lateral * a + slide * abs(a) * north, a + turn * d
        )
        calibration.learn(step, true, down)
    step, down = Pose2(0.05, 0.0, 0.04), (0.2, -0.1)
    got = calibration.correct(step, down)
    expected = (
        0.05 * (1 + meter) + slide * 0.04 * 0.2,
        lateral * 0.04 - slide * 0.04 * 0.1,
        0.04 + turn * 0.05,
    )
    np.testing.assert_allclose(got.as_array(), expected, atol=5e-4)


def eigenvalues(calibration: Calibration) -> tuple[float, float]:
    p, q, r = calibration.covariance
    low, high = np.linalg.eigvalsh(np.array(((p, q), (q, r)))).tolist()
    return low, high


STEPS = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(STEPS, st.integers(1, 400)), min_size=1, max_size=8),
    st.floats(1e-6, 1.0),
    st.floats(5.0, 800.0),
)
@example(parts=[((0.0, 0.5), 1), ((0.0, 2e-159), 1)], scale=1.0, memory=5.0)
def test_the_covariance_stays_within_bounds_whatever_is_driven(
    parts: list[tuple[tuple[float, float], int]], scale: float, memory: float
) -> None:
    """Positive definite, never above what was assumed at first, never below what the memory can hold."""
    config = CalibrationConfig(calibration_memory=memory)
    calibration = Calibration(config)
    longest = max(math.hypot(*step) for step, _ in parts) * scale
    most = longest**2 / config.calibration_noise**2 / (1 - math.exp(-1 / memory))
    for (d, a), times in parts:
        for _ in range(times):
            calibration.learn(Pose2(d * scale, 0.0, a * scale), Pose2(d * scale, 0.0, a * scale))
            low, high = eigenvalues(calibration)
            assert low >= 1 / (1 / config.calibration_per_meter**2 + 1.001 * most) * (1 - 1e-9)
            assert high <= config.calibration_per_meter**2 * (1 + 1e-9)


def test_circles_do_not_unlearn_the_straight() -> None:
    """An hour of circles keeps the unobserved gains, and the observed ones stay those of the odometry."""
    rng, calibration = np.random.default_rng(5), Calibration(CalibrationConfig())

    def drive(d: float, a: float) -> None:
        step = Pose2(d, 0.0, a)
        true = Pose2(1.03 * d + rng.normal(0, 0.01), rng.normal(0, 0.01), a + 0.02 * d + rng.normal(0, 0.005))
        calibration.learn(step, true)

    for _ in range(500):
        drive(0.2, 0.0)
    for _ in range(20_000):
        drive(0.1, 0.1)
        assert eigenvalues(calibration)[0] > 0
    straight = calibration.correct(Pose2(1.0, 0.0, 0.0))
    np.testing.assert_allclose(straight.as_array(), (1.03, 0.0, 0.02), atol=0.01)
    assert max(map(abs, calibration.gain)) < 0.05


def test_a_turn_on_a_slope_is_reckoned_downhill_once_it_is_known_to_slide() -> None:
    """Nose down (positive pitch) it falls ahead; left side up (positive roll) it falls to the right."""
    imu = Imu(roll=0.1, pitch=0.2)
    reckoning, at_rest = DeadReckoning(MotionConfig()), PoseEstimate(Pose2(), np.zeros((3, 3)))
    reckoning.predict(at_rest, Pose2(), imu, 0.0)
    yaw = 0.0
    for k in range(1, 400):
        yaw += 0.02
        reckoning.predict(at_rest, Pose2(yaw=yaw), imu, 0.04 * k)
        slid = 1.5 * 0.02
        reckoning.learn(Pose2(), Pose2(slid * math.sin(0.2), -slid * math.sin(0.1), 0.02))
    expected = reckoning.predict(at_rest, Pose2(yaw=yaw + 0.02), imu, 16.0).pose
    assert expected.x == pytest.approx(0.03 * math.sin(0.2), rel=0.05)
    assert expected.y == pytest.approx(-0.03 * math.sin(0.1), rel=0.05)


def test_a_circle_on_an_incline_returns_to_its_height() -> None:
    slope, radius = 0.2, 5.0
    yaws = np.linspace(0.0, math.tau, 401)
    normal = np.array((-math.sin(slope), 0.0, math.cos(slope)))  # rises along x
    odometry, imus = [], []
    for yaw in yaws:
        odometry.append(Pose2(radius * math.sin(yaw), radius * (1 - math.cos(yaw)), yaw))
        ahead = np.array((math.cos(yaw), math.sin(yaw), 0.0))
        ahead[2] = -(normal[:2] @ ahead[:2]) / normal[2]
        ahead /= np.linalg.norm(ahead)
        left = np.cross(normal, ahead)
        imus.append(Imu(roll=math.atan2(left[2], normal[2]), pitch=-math.asin(ahead[2])))
    poses = spatial_odometry(odometry, imus)
    rises = [pose.z - math.tan(slope) * pose.x for pose in poses]
    np.testing.assert_allclose(rises, 0.0, atol=1e-4)
    assert max(pose.z for pose in poses) == pytest.approx(radius * math.tan(slope), abs=1e-3)


def test_a_step_stays_in_the_plane_of_the_wheels() -> None:
    up = np.array((0.1, -0.2, 0.9))
    step = np.array((0.3, 0.1, climb(0.3, 0.1, up)))
    assert step @ up == pytest.approx(0.0, abs=1e-12)
