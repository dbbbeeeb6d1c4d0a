"""What is known about a log follows its lines when their stamps are repaired."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lirs_validation.logs.reference import reference_in_time, relations_in_time
from lirs_validation.metrics.relative_pose_error import RelativePoseConstraint
from lirs_wct.formats.laser_log import LineStamps
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory

LOGGED = np.array([5.0, 5.9, 5.5, 5.7, 7.0])
REPAIRED = np.array([5.0, 5.6, 5.7, 5.8, 7.0])
LINES = LineStamps(LOGGED, REPAIRED, np.ones(5, np.bool_))


def test_relations_are_moved_with_the_lines_they_name() -> None:
    relations = [RelativePoseConstraint(5.9, 5.5, Pose2(1.0)), RelativePoseConstraint(5.0, 7.0, Pose2(2.0))]
    moved = relations_in_time(relations, LINES)
    np.testing.assert_allclose([(r.stamp_a, r.stamp_b) for r in moved], [(5.6, 5.7), (5.0, 7.0)])
    assert [r.T_ab for r in moved] == [Pose2(1.0), Pose2(2.0)]


def test_a_reference_is_moved_and_stays_in_order() -> None:
    """The pose at the line of 5.9 s comes first: it is that of an earlier line."""
    reference = Trajectory.from_poses(np.sort(LOGGED).tolist(), [Pose2(float(k)) for k in range(5)])
    moved = reference_in_time(reference, LINES)
    np.testing.assert_allclose(moved.stamps, REPAIRED)
    assert moved.positions[:, 0].tolist() == [0, 3, 1, 2, 4]


@given(st.floats(-100, 100))
def test_of_a_sound_log_nothing_moves(stamp: float) -> None:
    sound = LineStamps(REPAIRED, REPAIRED, np.ones(5, np.bool_))
    relation = RelativePoseConstraint(stamp, stamp + 1, Pose2())
    assert relations_in_time([relation], sound) == (relation,)
    assert sound.repaired_at(np.array([stamp])).tolist() == [stamp]
