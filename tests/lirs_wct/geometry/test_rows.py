from __future__ import annotations

from operator import attrgetter

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.rows import Rows
from lirs_wct.geometry.scan import Imu


def test_rows_are_a_sequence_of_equal_values() -> None:
    rng = np.random.default_rng(4)
    poses = [Pose3(*row) for row in rng.normal(size=(9, 7)).tolist()]
    rows = Rows.of(Pose3)
    for pose in poses:
        rows.append(pose)
    assert list(rows) == poses == rows[:]
    assert (len(rows), rows[0], rows[-1], rows[2:7:2]) == (9, poses[0], poses[-1], poses[2:7:2])
    np.testing.assert_array_equal(rows.as_array()[:, :3], [pose.position for pose in poses])
    for wrong in (9, -10):
        with pytest.raises(IndexError):
            rows[wrong]


def test_rows_without_values_have_their_width() -> None:
    rows = Rows.of(Pose2)
    assert rows.as_array().shape == (0, 3)
    assert list(rows) == []


def test_an_inertial_reading_is_nine_numbers() -> None:
    reading = Imu(0.1, -0.2, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 7.5)
    assert Imu.from_row(*reading.row) == reading
    rows = Rows(Imu.from_row, attrgetter("row"), 9)
    rows.append(reading)
    assert rows[0] == reading


def test_an_array_of_rows_does_not_stop_them_from_growing() -> None:
    rows = Rows.of(Pose2)
    rows.append(Pose2(1, 2, 3))
    before = rows.as_array()
    rows.append(Pose2(4, 5, 6))
    assert len(before) == 1
    assert len(rows) == 2
