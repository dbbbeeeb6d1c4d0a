"""Floor plans: one building, all of whose rooms a robot can reach."""

import cv2
import numpy as np
import pytest

from lirs_envs.generators.floor_plan import CELL, SIZE, floor_plan
from lirs_wct.navigation.traversability import traversable


@pytest.mark.parametrize("seed", range(8))
def test_a_robot_can_reach_nearly_all_of_the_floor(seed: int) -> None:
    plan = floor_plan(np.random.default_rng(seed))
    free = traversable(plan.surface, plan.walls, clearance=0.31 + 0.15, max_slope=0.3)
    _, _, stats, _ = cv2.connectedComponentsWithStats(free.free.astype(np.uint8), connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    assert areas.max() >= 0.97 * areas.sum()
    assert areas.max() * 0.1**2 > 0.5 * SIZE[0] * SIZE[1]


def test_a_building_is_closed_and_divided() -> None:
    walls = floor_plan(np.random.default_rng(2)).walls
    assert walls.shape == (round(SIZE[1] / CELL), round(SIZE[0] / CELL))
    assert walls.solid[[0, -1], :].all()
    assert walls.solid[:, [0, -1]].all()
    assert 0.03 < walls.solid.mean() < 0.2


def test_the_same_seed_gives_the_same_plan() -> None:
    plans = [floor_plan(np.random.default_rng(seed)).walls.solid for seed in (4, 4, 5)]
    assert np.array_equal(plans[0], plans[1])
    assert not np.array_equal(plans[0], plans[2])
