"""Patterns of beams: what rings see, and how fast."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from lirs_envs.lidar.pattern import BeamPattern, PatternLidar, rings
from lirs_envs.props import Prop
from lirs_envs.robots.robot import Robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.world import World
from tests.lirs_envs.lidar.room import room

MOUNT = Pose3(0.2, 0.05, 0.3)


def test_rings_see_floor_and_walls_within_three_milliseconds() -> None:
    pattern = BeamPattern(directions=rings(16, 900, (math.radians(-15), math.radians(15))))
    lidar = PatternLidar(pattern, room(), MOUNT, np.random.default_rng(0))
    ranges = lidar.ranges(Pose3(0.5, -0.4, 0.2))
    assert ranges.shape == (14400,)
    points = Pose3(0.5, -0.4, 0.2).apply(lidar.points(ranges))
    wall = np.minimum(np.abs(np.abs(points[:, 0]) - 4.0), np.abs(np.abs(points[:, 1]) - 3.0))
    assert np.minimum(wall, np.abs(points[:, 2])).max() < 1e-5
    assert (np.abs(points[:, 2]) < 1e-5).any()
    best = math.inf
    for _ in range(20):
        begun = time.perf_counter()
        lidar.ranges(Pose3(0.5, -0.4, 0.2))
        best = min(best, time.perf_counter() - begun)
    assert best < 3e-3


def test_rings_on_a_simulation_see_props_and_not_their_own_robot(plane: World, husky: Robot) -> None:
    box = Prop(shape="box", size=(0.3, 0.3, 0.5), place=Pose2(3.0, 0.0))
    sim = Simulation(plane, SimulationConfig(robot=husky, props=(box,)))
    sim.reset()
    pattern = BeamPattern(directions=rings(9, 720, (-1.5, 0.3)), range_min=0.0, range_max=8.0)
    lidar = PatternLidar(pattern, sim.caster, husky.T_base_laser, np.random.default_rng(0))
    points = sim.T_world_base.apply(lidar.points(lidar.ranges(sim.T_world_base)))
    floor = np.abs(points[:, 2]) < 1e-5
    on_box = np.abs(np.maximum(np.abs(points[:, 0] - 3.0), np.abs(points[:, 1])) - 0.3) < 1e-4
    assert (floor | on_box).all(), "nothing of the robot, though beams go down through it"
    assert floor.sum() > 2000
    assert on_box.sum() > 50


def test_patterns_that_cannot_be() -> None:
    with pytest.raises(ConfigError, match="unit vectors"):
        BeamPattern(directions=np.ones((4, 3)))
    with pytest.raises(ConfigError, match="range_min"):
        BeamPattern(directions=np.eye(3), range_min=5.0, range_max=1.0)
    with pytest.raises(ConfigError, match="at least 1 ring"):
        rings(0, 900, (0.0, 0.1))
