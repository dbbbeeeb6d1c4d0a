"""The watch on a method's poses: alarms where a path jumps, and none where it is smooth."""

import math
from itertools import accumulate

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_validation.metrics.failure import window_errors
from lirs_wct import FloatArray, Pose2
from lirs_wct.errors import ConfigError
from slam_baselines.watch import MIDDLE, Watch

RATE = 20.0
SEEDS = st.integers(0, 10_000)


def smooth(seed: int, seconds: float = 30.0) -> FloatArray:
    """Return (n, 3) poses of a robot whose speed and rate of turn change slowly."""
    rng, n = np.random.default_rng(seed), round(seconds * RATE)
    times = np.arange(n) / RATE
    v = 1.0 + 0.5 * np.sin(rng.uniform(0.1, 0.6) * times + rng.uniform(0, 6))
    w = rng.uniform(-0.8, 0.8) * np.sin(rng.uniform(0.1, 0.8) * times + rng.uniform(0, 6))
    steps = (Pose2(a / RATE, 0.0, b / RATE) for a, b in zip(v, w, strict=True))
    return np.array([pose.as_array() for pose in accumulate(steps, Pose2.__matmul__)])


def watched(poses: FloatArray, odometry: FloatArray | None = None) -> tuple[Watch, FloatArray]:
    """Return the watch after these poses, and its error after each."""
    watch, errors = Watch(), []
    for k, pose in enumerate(poses.tolist()):
        watch.update(Pose2(*pose), k / RATE, None if odometry is None else Pose2(*odometry[k]))
        errors.append(watch.error)
    return watch, np.array(errors)


def jumped(poses: FloatArray, at: int, T: Pose2) -> FloatArray:
    """Return the poses with a jump: from `at` on, they are moved by a pose in the robot's frame there."""
    moved = poses.copy()
    T_new_old = Pose2(*poses[at]) @ T @ Pose2(*poses[at]).inverse()
    moved[at:] = [(T_new_old @ Pose2(*pose)).as_array() for pose in poses[at:].tolist()]
    return moved


@given(SEEDS, st.floats(0.0, 0.003))
@settings(max_examples=10, deadline=None)
def test_a_smooth_path_gives_no_alarm(seed: int, noise: float) -> None:
    poses = smooth(seed)
    poses[:, :2] += noise * np.random.default_rng(seed).standard_normal((len(poses), 2))
    watch, errors = watched(poses)
    assert watch.alarms == []
    assert np.nanmax(errors) < 0.06


@given(SEEDS, st.floats(0.5, 2.0), st.floats(0.0, 2 * math.pi), st.floats(-0.5, 0.5))
@settings(max_examples=10, deadline=None)
def test_a_jump_gives_an_alarm_within_two_seconds(
    seed: int, length: float, bearing: float, turn: float
) -> None:
    at = 300
    T = Pose2(length * math.cos(bearing), length * math.sin(bearing), turn)
    watch, _ = watched(jumped(smooth(seed), at, T))
    assert 0 <= watch.alarms[0] - at / RATE < 2.0


def test_the_error_of_a_jump_is_its_ate_over_the_last_meters() -> None:
    true = smooth(3)
    found = watched(jumped(true, 300, Pose2(0.3, 0.4, 0.2)))[1]
    expected = window_errors(true, jumped(true, 300, Pose2(0.3, 0.4, 0.2)))
    late = np.arange(200, len(true) - MIDDLE)
    np.testing.assert_allclose(found[late + MIDDLE], expected[late], atol=0.02)


@given(SEEDS, st.floats(-50, 50), st.floats(-math.pi, math.pi))
@settings(max_examples=10, deadline=None)
def test_the_frame_of_the_map_does_not_matter(seed: int, shift: float, turn: float) -> None:
    poses = jumped(smooth(seed), 300, Pose2(0.2, 0.1, 0.1))
    T = Pose2(shift, -shift, turn)
    moved = np.array([(T @ Pose2(*pose)).as_array() for pose in poses.tolist()])
    np.testing.assert_allclose(watched(moved)[1], watched(poses)[1], atol=1e-6)


def test_the_error_is_at_most_that_to_the_odometry() -> None:
    true = smooth(4)
    found = jumped(true, 300, Pose2(0.5, 0.5, 0.1))
    assert watched(found, odometry=found)[1][50:] == pytest.approx(0.0, abs=1e-6)
    alone, beside = watched(found), watched(found, odometry=true)
    assert alone[0].alarms == beside[0].alarms != []
    assert (beside[1][50:] <= alone[1][50:] + 1e-6).all()


def test_the_beginning_of_a_path_is_compared_with_the_odometry() -> None:
    true = smooth(4)
    found = true.copy()
    found[:, :2] = 0.5 * true[:, :2]  # half as far as by the wheels, without a jump
    assert not watched(found)[0].alarms
    assert watched(found, odometry=true)[0].alarms


def straight(jump: float, at: float, rate: float) -> Watch:
    """Return the watch after 20 m at 1 m/s, with a jump sideways, in meters, at a time."""
    watch = Watch()
    for k in range(round(20 * rate)):
        watch.update(Pose2(k / rate, jump * (k / rate > at)), k / rate)
    return watch


def test_a_path_of_few_meters_has_a_smaller_limit() -> None:
    assert straight(0.4, 1.0, 20.0).alarms
    assert not straight(0.4, 12.0, 20.0).alarms


@pytest.mark.parametrize(("rate", "seen"), [(40.0, True), (10.0, True), (5.0, True), (2.0, False)])
def test_a_jump_of_a_meter_is_seen_from_four_poses_a_second_on(rate: float, seen: bool) -> None:
    assert bool(straight(1.0, 10.0, rate).alarms) == seen


def test_an_alarm_ends_when_the_jump_is_far_behind_and_the_next_one_is_counted() -> None:
    watch, _ = watched(jumped(jumped(smooth(1, 60.0), 200, Pose2(1.0)), 800, Pose2(1.0)))
    assert [round(stamp) for stamp in watch.alarms] == [10, 40]
    assert not watch.alarm


def test_a_robot_that_stands_for_long_does_not_fill_the_window() -> None:
    poses = np.repeat(smooth(1, 6.0)[-1:], 20_000, axis=0)
    watch, errors = watched(
        np.concatenate((smooth(1, 6.0), poses, jumped(smooth(1, 12.0), 121, Pose2(1.0))[121:]))
    )
    assert watch.alarms[0] > 1000
    assert np.isfinite(errors[200:]).all()


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan])
def test_an_illegal_limit_is_refused(wrong: float) -> None:
    with pytest.raises(ConfigError, match="limit"):
        Watch(wrong)
