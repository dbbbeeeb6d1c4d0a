"""The rehearsal leaves no kernel to be compiled on the clock."""

from __future__ import annotations

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from slam_baselines import warmup as rehearsal
from slam_baselines.mapper import MAPPERS, make_mapper


def test_the_room_is_seen_where_it_is() -> None:
    ranges = rehearsal._scan(Pose2(-rehearsal.MOUNT.x, 0.0, 0.0), 0.0).ranges
    assert ranges[rehearsal.BEAMS // 2] == pytest.approx(6.0)
    assert np.isfinite(ranges).all()


@pytest.mark.parametrize("name", MAPPERS)
def test_every_mapper_keeps_its_place_in_the_rehearsal_room(name: str) -> None:
    mapper = make_mapper(name)
    start = rehearsal._on_circle(0.0)
    for k in range(40):
        pose = rehearsal._on_circle(k * rehearsal.STEP / rehearsal.RADIUS)
        found = mapper.update(rehearsal._scan(pose, 0.2 * k), start.inverse() @ pose, None)
    assert found.distance(start.inverse() @ pose) < 0.1
    rehearsal.rehearse(name)


def test_a_seed_reaches_the_mapper_that_draws_and_leaves_the_others_alone() -> None:
    assert make_mapper("gmapping", seed=7).config.seed == 7  # type: ignore[attr-defined]
    assert make_mapper("hector", seed=7).lost is False
