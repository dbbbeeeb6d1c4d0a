"""The correlative search."""

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from slam_baselines.matching.correlative import SearchConfig, correlative_search
from tests.slam_baselines.matching.room import room_map


def test_the_wider_search_survives_a_sharp_turn() -> None:
    true = Pose2(0.5, -0.3, 0.4)
    builder, points = room_map(true)
    start = true.as_array() + np.array((0.4, -0.3, 0.42))
    found = correlative_search(
        builder.pyramid.maps[2].grid, points, np.ones(len(points)), start, SearchConfig()
    )
    np.testing.assert_allclose(found[:2], true.as_array()[:2], atol=0.2)
    assert found[2] == pytest.approx(0.4, abs=0.04)
