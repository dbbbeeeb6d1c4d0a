"""Scans: which beam looks where, and which readings are hits."""

import math

import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import LaserScan


def scan(ranges: list[float]) -> LaserScan:
    return LaserScan(np.float32(ranges), -1.5, 0.25, 0.5, 8.0, 12.5)


def test_angles_go_counter_clockwise_from_the_first_beam() -> None:
    assert scan([1.0] * 4).angles.tolist() == [-1.5, -1.25, -1.0, -0.75]
    assert scan([]).angles.shape == (0,)
    assert (scan([1.0]).T_base_laser, scan([1.0]).time_increment) == (Pose3(), 0.0)


def test_hits_lie_within_the_sensors_range_its_ends_included() -> None:
    readings = [0.49, 0.5, 4.0, 8.0, 8.01, math.inf, -math.inf, math.nan]
    assert scan(readings).hits.tolist() == [False, True, True, True, False, False, False, False]


@pytest.mark.parametrize("ranges", [np.zeros(3), np.zeros((3, 1), np.float32), np.float32(1.0)])
def test_ranges_are_a_vector_of_float32(ranges: np.ndarray) -> None:
    with pytest.raises(ConfigError, match="ranges must be a vector of float32"):
        LaserScan(ranges, 0.0, 0.1, 0.1, 9.0, 0.0)
