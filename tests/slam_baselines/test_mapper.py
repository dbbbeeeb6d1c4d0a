"""What all methods offer alike: resolution, need of odometry, localization in a known map."""

import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import LaserScan
from slam_baselines.mapper import MAPPERS, make_mapper, requires_odometry

SCAN = LaserScan(np.full(90, 2.0, np.float32), -0.8, 0.0175, 0.1, 10.0, 5.0)


@pytest.mark.parametrize("name", MAPPERS)
def test_the_resolution_is_one_word_for_all(name: str) -> None:
    mapper = make_mapper(name, resolution=0.1)
    mapper.update(SCAN, Pose2(), None)
    assert mapper.map().resolution == mapper.resolution == 0.1  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", MAPPERS)
def test_a_mapper_that_requires_odometry_refuses_to_go_without(name: str) -> None:
    mapper = make_mapper(name)
    if requires_odometry(mapper):
        with pytest.raises(ConfigError, match=rf"{name} needs odometry, the scan at 5\.0 s has none"):
            mapper.update(SCAN, None, None)
    else:
        assert mapper.update(SCAN, None, None) == Pose2()


def test_a_mapper_that_does_not_say_requires_no_odometry() -> None:
    assert not requires_odometry(object())  # type: ignore[arg-type]


def test_a_localizer_keeps_the_frame_of_its_map() -> None:
    p = np.zeros((80, 60))
    p[[0, -1]] = p[:, [0, -1]] = 1.0
    known = OccupancyGrid.from_probability(p, 0.05, Pose2(-1.0, 2.0))
    localizer = make_mapper("cartographer", map=known, start=Pose2(0.5, 3.0, 0.2))
    assert localizer.known_map is localizer.map() is known  # type: ignore[attr-defined]
    assert not requires_odometry(localizer)
    assert localizer.update(SCAN, None, None).distance(Pose2(0.5, 3.0, 0.2)) < 0.5
