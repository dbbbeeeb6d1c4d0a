"""Path lengths over the free cells of a site."""

import math

import numpy as np
import pytest

from lirs_envs.robots.catalog import make_robot
from lirs_envs.robots.robot import Robot
from lirs_envs.tasks.site import make_site
from lirs_wct.geometry.grid_search import search
from lirs_wct.world import World


@pytest.mark.parametrize("limit", [math.inf, 7.3])
@pytest.mark.parametrize("robot", ["husky", "turtlebot2"])
def test_path_lengths_are_those_of_the_general_search(rough: World, robot: str, limit: float) -> None:
    site = make_site(rough, make_robot(robot))
    rng, free = np.random.default_rng(0), site.areas > 0
    for _ in range(4):
        start = site.draw_start(rng)
        cell = site.grid.cells((start.x, start.y))
        weight = np.where(free, 1.0, np.inf)
        expected = search(weight, cell[None], site.grid.resolution, limit=limit).cost
        found = site.distances(start.x, start.y, limit)
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        assert 100 < np.isfinite(found).sum() < free.size


def test_no_path_starts_at_a_blocked_cell(rough: World, husky: Robot) -> None:
    site = make_site(rough, husky)
    row, col = np.argwhere(site.areas == 0)[100]
    x, y = site.grid.centers(np.array([(row, col)]))[0].tolist()
    assert not np.isfinite(site.distances(x, y)).any()
