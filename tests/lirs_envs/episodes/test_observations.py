"""Scaled observations: sectors of a scan, the direction of a goal."""

import math

import numpy as np
import pytest

from lirs_envs.env import RobotEnv
from lirs_envs.episodes.observations import SECTORS, goal_direction, scan_sectors
from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_wct.world import World


@pytest.mark.parametrize("name", ["lms111", "utm30lx", "urg04lx", "lds01"])
def test_a_sector_is_as_near_as_its_nearest_beam(name: str) -> None:
    lidar = make_lidar_preset(name)
    rng = np.random.default_rng(lidar.beams)
    ranges = rng.uniform(0.1, 60.0, (3, lidar.beams)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.2] = np.inf
    for value in (-np.inf, np.nan, 0.0):
        ranges[rng.random(ranges.shape) < 0.1] = value
    ranges[1, : lidar.beams // 3] = np.nan
    found = scan_sectors(ranges, lidar)
    degrees = np.degrees(lidar.angle_min + lidar.angle_increment * np.arange(lidar.beams)) + 1e-6
    for row, sectors in zip(ranges, found, strict=True):
        for s in range(SECTORS):
            inside = (degrees >= 10 * s - 180) & (degrees < 10 * s - 170)
            valid = [min(r, lidar.range_max) for r in row[inside].tolist() if r > 0]
            expected = 1 / (1 + min(valid)) if valid else 1.0 if inside.any() else 0.0
            assert sectors[s] == pytest.approx(expected)
    assert 1.0 in found[1]
    assert (0.0 in found) == (lidar.fov < math.tau)


@pytest.mark.parametrize("robot", ["husky", "turtlebot3_waffle"])
def test_sectors_are_those_of_the_robot_for_every_lidar(walled: World, robot: str) -> None:
    """The wall is ahead and to the left, open ground to the right."""
    env = RobotEnv("navigation", world=walled, robot=robot, observe=["scan", "sectors"], noise="none")
    observation, _ = env.reset(seed=0, options={"start": [0.0, 0.0, -0.7], "goal": [0.0, 2.0]})
    sectors = observation["sectors"]
    assert env.observation_space.contains(observation)
    assert sectors[5:12].mean() < sectors[20:27].mean()
    lidar = make_lidar_preset(make_robot(robot).lidar)
    assert sectors.tolist() == scan_sectors(observation["scan"][None], lidar)[0].tolist()


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
