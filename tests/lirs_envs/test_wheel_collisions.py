"""Wheels collide with what is steeper than their robot climbs, and with nothing else."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from lirs_envs.env import RobotEnv
from lirs_envs.robot_group import SingleBody
from lirs_envs.robot_model import RobotModel, contact_state
from lirs_envs.robots.control import make_controllers
from lirs_envs.robots.robot import ROBOTS, Twist, make_robot
from lirs_envs.simulation import ROW
from lirs_envs.simulation_config import SimulationConfig, standing_pose
from lirs_envs.tasks.site import make_site
from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.geometry.pose import Pose2
from lirs_wct.sources.build import build_world
from lirs_wct.world import World
from tests.kit import started

GROUND = [name for name, robot in ROBOTS.items() if not robot.flies]
SPEEDS = np.array(((1 / 3, 0.0), (2 / 3, 0.0), (1.0, 0.0)))
BOX = {"shape": "box", "size": (0.1, 1.0, 0.3), "place": (3.1, 0.0, 0.0)}


@lru_cache(maxsize=2)
def world_of(name: str) -> World:
    return build_world(name)


@pytest.mark.parametrize("name", GROUND)
@pytest.mark.parametrize("kind", ["laser map", "terrain", "prop"])
def test_a_wall_is_a_collision_at_once(
    kind: str, name: str, walled: World, plane: World, T_world_wall: Pose2, make_world: Callable[..., World]
) -> None:
    frame, robot = T_world_wall if kind == "laser map" else Pose2(), make_robot(name)
    ridge = make_world(lambda x, _: 0.5 * ((x > 2.95) & (x < 4.0)))
    world = {"laser map": walled, "terrain": ridge, "prop": plane}[kind]
    props = (BOX,) if kind == "prop" else ()
    env = RobotVectorEnv(
        3, "navigation", world=world, robot=name, props=props, autoreset_mode="Disabled", threads=1
    )
    start = frame @ Pose2(3.0 - robot.radius - 0.3, 0.0, 0.3)
    env.reset(seed=1, options={"start": start, "goal": frame.apply((0.0, 0.0))})
    for speed in range(3):
        row, steps = np.array((speed,)), 0
        while not env.episodes.terminated[speed]:
            env.episodes.step(row, SPEEDS[row])
            steps += 1
        info = env.episodes.infos()
        assert info["reason"][speed] == "collision", speed
        # The wheels stand out of the Jackal on all sides: it is not let climb.
        assert abs(env.episodes.parts[0].simulation.pose(speed).rotation[2, 2]) > math.cos(math.radians(15))
        assert steps * 0.1 < 2.0 + 0.5 / (SPEEDS[speed, 0] * robot.max_speed)


def test_one_environment_collides_as_a_vector_does(walled: World, T_world_wall: Pose2) -> None:
    options = {"start": T_world_wall @ Pose2(2.0, 0.0), "goal": T_world_wall.apply((0.0, 0.0))}
    chosen = {"world": walled, "robot": "jackal"}
    one, two = RobotEnv("navigation", **chosen), RobotVectorEnv(2, "navigation", threads=1, **chosen)
    one.reset(seed=3, options=options)
    two.reset(seed=3, options=options)
    ended = False
    while not ended:
        _, reward, ended, _, info = one.step(SPEEDS[2])
        _, rewards, terminated, _, infos = two.step(SPEEDS[[2, 2]])
        assert (reward, ended, info["contact"]) == (rewards[0], terminated[0], infos["contact"][0])
    assert info["reason"] == "collision"


def test_validation_counts_a_wheel_at_a_wall(walled: World, T_world_wall: Pose2) -> None:
    sim = started(walled, T_world_wall @ Pose2(2.0, 0.0), robot=make_robot("jackal"))
    while sim.collisions.body_contacts == 0:
        assert sim.time() < 2.0
        sim.advance(Twist(1.0))
    assert not sim.find_tipped()[0]


@pytest.mark.parametrize("name", GROUND)
@pytest.mark.parametrize("where", ["simple", pytest.param("medium", marks=pytest.mark.slow)])
def test_ground_that_can_be_driven_is_none(where: str, name: str) -> None:
    world, robot = world_of(where), make_robot(name)
    site = make_site(world, replace(robot, radius=robot.radius + 0.3))
    body, rng = RobotModel(world, SimulationConfig(robot=robot), 0.1), np.random.default_rng(2)
    driven = 0.0
    for _ in range(5):
        body.settle(standing_pose(world, robot, site.draw_start(rng)))
        single, turn = SingleBody(robot, body), rng.uniform(-1, 1)
        drive = make_controllers(robot, body.actuators, [body])
        drive.begin(0)
        command = np.array(((robot.max_speed, turn * robot.max_turn_rate, 0.0),))
        for _ in range(20):
            before = body.pose()
            if not site.area(before.x, before.y):
                break
            for steps in body.substeps:
                dt = steps * body.timestep
                drive.update(ROW, command, np.array((body.rates(),)), dt, body.ctrl[None])
                body.step(steps)
                single.add_touching(np.zeros(1, np.bool_), dt)
            here = body.pose()
            driven += math.hypot(here.x - before.x, here.y - before.y)
        assert single.collisions.body_contacts == 0
    assert driven > 3 * robot.max_speed


DROPS = np.array((-np.inf, 0.8, np.inf))
"""The ground, a wheel of 1 m, the body."""
CENTERS = np.array(((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_single_contacts_and_several_wait_for_no_compiler(count: int) -> None:
    # As MuJoCo has them: every contact is a row of many numbers.
    rows = np.zeros((count, 20))
    rows[:, 0] = -0.001 * np.arange(1, count + 1)
    pairs = np.zeros((count, 10), np.int32)[:, :2]
    pairs[:, 1] = 1
    state = rows[:, 0], pairs, rows[:, 1:4], CENTERS, DROPS
    assert contact_state(*state) == (0.001 * count, False)
    pairs[-1] = 2, 0
    assert contact_state(*state) == (0.001 * count, True)
    assert len(contact_state.signatures) == 1


@pytest.mark.parametrize(("height", "collides"), [(0.0, False), (0.19, False), (0.21, True), (1.0, True)])
def test_a_wheel_collides_with_what_it_meets_high(height: float, collides: bool) -> None:
    pairs, points = np.array(((1, 0),), np.int32), np.array(((0.9, 0.0, height),))
    assert contact_state(np.zeros(1), pairs, points, CENTERS, DROPS) == (0.0, collides)
