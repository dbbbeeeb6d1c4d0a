"""Scaled observations: sectors of a scan, the direction of a goal."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lirs_envs.env import RobotEnv
from lirs_envs.episodes.observations import SECTORS, goal_direction, scan_sectors
from lirs_wct.errors import ConfigError
from lirs_wct.world import World


@pytest.mark.parametrize("beams", [541, 1081, 682, 360, 36])
def test_a_sector_is_as_near_as_its_nearest_beam(beams: int) -> None:
    rng = np.random.default_rng(beams)
    ranges = rng.uniform(0.1, 40.0, (3, beams)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.2] = np.inf
    for value in (-np.inf, np.nan, 0.0):
        ranges[rng.random(ranges.shape) < 0.1] = value
    ranges[1, : beams // 4] = np.nan
    found = scan_sectors(ranges, 20.0)
    sector_of = np.arange(beams) * SECTORS // beams
    for row, sectors in zip(ranges, found, strict=True):
        for s in range(SECTORS):
            valid = [min(r, 20.0) for r in row[sector_of == s].tolist() if r > 0]
            assert sectors[s] == pytest.approx(1 / (1 + min(valid)) if valid else 1.0)
    assert (found[1, :8] == 1.0).all()


def test_sectors_run_from_right_to_left(walled: World) -> None:
    """The wall is ahead and to the left, open ground to the right."""
    env = RobotEnv("navigation", world=walled, observe=["scan", "sectors"], noise="none")
    observation, _ = env.reset(seed=0, options={"start": [0.0, 0.0, -0.7], "goal": [0.0, 2.0]})
    sectors, scan = observation["sectors"], observation["scan"]
    assert env.observation_space.contains(observation)
    assert sectors[:10].max() < 0.1 < sectors[20:30].min()
    assert sectors.tolist() == scan_sectors(scan[None], float(scan.max()))[0].tolist()


def test_goal_direction_is_that_of_the_goal(plane: World) -> None:
    env = RobotEnv("navigation", world=plane, observe=["goal", "goal_direction"])
    for seed in range(5):
        observation, info = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        T, (cos, sin, distance) = env.view.T_world_base, observation["goal_direction"].tolist()
        x, y = T.to_pose2().apply((30 * distance * cos, 30 * distance * sin)).tolist()
        assert (x, y) == pytest.approx(info["goal"].tolist(), abs=1e-4)
    far = goal_direction(np.array(((45.0, math.pi), (45.0, -math.pi))))
    assert far[0] == pytest.approx(far[1], abs=1e-6)
    assert far[0].tolist() == pytest.approx([-1.0, 0.0, 1.0], abs=1e-6)


def test_no_direction_without_a_goal(plane: World) -> None:
    with pytest.raises(ConfigError, match="the mapping task has no goal to observe"):
        RobotEnv("mapping", world=plane, observe=["goal_direction"])
