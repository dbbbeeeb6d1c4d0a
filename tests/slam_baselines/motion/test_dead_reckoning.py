"""Several steps at once lead where they lead one after the other."""

import math

import numpy as np
from hypothesis import given, settings, strategies as st

from lirs_wct.geometry.pose import Pose2
from slam_baselines.dead_reckoning import MotionConfig, PoseEstimate

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
