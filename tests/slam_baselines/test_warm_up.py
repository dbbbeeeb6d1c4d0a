"""The warm-up leaves no kernel to be compiled on the clock."""

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from slam_baselines import warm_up
from slam_baselines.mapper import MAPPERS, make_mapper


def test_the_room_is_seen_where_it_is() -> None:
    ranges = warm_up._scan(Pose2(-warm_up.MOUNT.x, 0.0, 0.0), 0.0).ranges
    assert ranges[warm_up.BEAMS // 2] == pytest.approx(6.0)
    assert np.isfinite(ranges).all()


@pytest.mark.parametrize("name", MAPPERS)
def test_every_mapper_keeps_its_place_in_the_warm_up_room(name: str) -> None:
    mapper = make_mapper(name)
    start = warm_up._on_circle(0.0)
    for k in range(40):
        pose = warm_up._on_circle(k * warm_up.STEP / warm_up.RADIUS)
        found = mapper.update(warm_up._scan(pose, 0.2 * k), start.inverse() @ pose, None)
    # The original drops the first odometry and turns one scan late: a start at full speed displaces it.
    assert found.distance(start.inverse() @ pose) < (0.4 if name == "cartographer_original" else 0.1)
    warm_up.warm_up(name)


def test_a_seed_reaches_the_mapper_that_draws_and_leaves_the_others_alone() -> None:
    assert make_mapper("gmapping", seed=7).config.seed == 7  # type: ignore[attr-defined]
    assert make_mapper("hector", seed=7).lost is False
