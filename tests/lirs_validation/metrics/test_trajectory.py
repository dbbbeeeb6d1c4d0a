"""Trajectory errors: what is known without a computer."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Trajectory

finite = st.floats(-50, 50)
poses = st.builds(Pose2, finite, finite, st.floats(-math.pi, math.pi))


def circle(n: int = 200, radius: float = 3.0, rate: float = 25.0) -> Trajectory:
    angles = np.linspace(0, 1.5 * math.pi, n)
    path = [Pose2(radius * math.cos(a), radius * math.sin(a), a + math.pi / 2) for a in angles.tolist()]
    return Trajectory.from_poses((np.arange(n) / rate).tolist(), path)


@given(poses)
def test_a_moved_copy_has_no_aligned_error(T: Pose2) -> None:
    truth = circle()
    errors = trajectory_errors(truth, truth.moved(T))
    assert errors.ate_rmse < 1e-9
    assert errors.yaw_rmse < 1e-6
    assert errors.rpe_metre.translation_rmse < 1e-9


@given(poses)
def test_the_start_pose_brings_the_map_frame_home(start: Pose2) -> None:
    truth = circle()
    errors = trajectory_errors(truth, truth.moved(start.inverse()), T_world_map=start)
    assert errors.ate_rmse_unaligned < 1e-9
    assert errors.final_drift < 1e-9


@given(poses, poses)
def test_moving_both_changes_nothing(T: Pose2, shift: Pose2) -> None:
    truth, estimate = circle(), circle(radius=3.2)
    one = trajectory_errors(truth, estimate)
    both = trajectory_errors(truth.moved(T), estimate.moved(T))
    assert both.ate_rmse == pytest.approx(one.ate_rmse, abs=1e-9)
    assert both.ate_rmse_unaligned == pytest.approx(one.ate_rmse_unaligned, abs=1e-9)
    # The aligned error does not care where the estimate lies, either.
    elsewhere = trajectory_errors(truth, estimate.moved(shift))
    assert elsewhere.ate_rmse == pytest.approx(one.ate_rmse, abs=1e-9)


def test_a_robot_that_stands_still() -> None:
    still = Trajectory.from_poses([0.0, 0.1, 0.2], [Pose2(1, 2, 3)] * 3)
    errors = trajectory_errors(still, still)
    assert (errors.ate_rmse, errors.length, errors.rpe_metre, errors.rpe_second) == (0.0, 0.0, None, None)


def test_trajectories_of_other_times_are_refused() -> None:
    late = Trajectory.from_poses([100.0, 101.0], [Pose2(), Pose2(1, 0, 0)])
    with pytest.raises(ConfigError, match="at least 2 poses"):
        trajectory_errors(circle(), late)


def test_two_poses_by_hand() -> None:
    truth = Trajectory.from_poses([0.0, 1.0], [Pose2(0.0, 0.0, 3.1), Pose2(0.0, 4.0, 3.1)])
    estimate = Trajectory.from_poses([0.01, 1.01], [Pose2(0.0, 0.0, 3.1), Pose2(3.0, 4.0, -3.1)])
    errors = trajectory_errors(truth, estimate)
    turned = math.tau - 6.2
    assert (errors.poses, errors.length) == (2, 4.0)
    assert (errors.ate_rmse, errors.ate_max) == pytest.approx((0.5, 0.5))  # 5 m laid along 4 m
    assert errors.ate_rmse_unaligned == pytest.approx(math.sqrt(9 / 2))
    assert (errors.final_drift, errors.final_yaw_drift) == pytest.approx((3.0, turned))
    lean = math.atan2(3.0, 4.0)  # the alignment turns the estimate so far to the left
    assert errors.yaw_rmse == pytest.approx(math.sqrt((lean**2 + (lean + turned) ** 2) / 2))
    for relative in (errors.rpe_metre, errors.rpe_second):
        assert (relative.translation_rmse, relative.rotation_rmse) == pytest.approx((3.0, turned))
        assert relative.pairs == 1


def test_relative_errors_are_per_meter_and_per_second() -> None:
    """At 2 m/s: eight poses a second, four a meter."""
    stamps = (np.arange(33) / 8).tolist()
    truth = Trajectory.from_poses(stamps, [Pose2(2 * t) for t in stamps])
    errors = trajectory_errors(truth, Trajectory.from_poses(stamps, [Pose2(2.5 * t) for t in stamps]))
    meter, second = errors.rpe_metre, errors.rpe_second
    assert (meter.pairs, second.pairs) == (8, 25)
    assert (meter.translation_rmse, second.translation_rmse) == pytest.approx((0.25, 0.5))


def test_one_common_pose_is_refused() -> None:
    late = Trajectory.from_poses([0.0, 50.0], [Pose2(), Pose2(1.0)])
    with pytest.raises(ConfigError, match="got 1 of 2 true and 200 estimated"):
        trajectory_errors(late, circle())
