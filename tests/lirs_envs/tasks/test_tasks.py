"""Tasks: rewards that add up to what they stand for, ends that are told, goals that can be reached."""

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from lirs_envs.env import RobotEnv
from lirs_envs.episodes.observations import NO_GROUND
from lirs_envs.robots.robot import make_robot
from lirs_envs.tasks.site import SEEN_CELL, make_site
from lirs_envs.tasks.task import TASKS, MappingTask, NavigationTask, Rewards, register_task
from lirs_validation.driving.paths import search
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import Terrain
from lirs_wct.world import World

EFFORT = -Rewards().effort
AHEAD = np.array((1.0, 0.0), np.float32)


def test_mapping_reward_is_the_ground_newly_seen(rough: World) -> None:
    env = RobotEnv("mapping", world=rough, rewards={"contact": 0.0})
    _, first = env.reset(seed=1)
    total = 0.0
    rng = np.random.default_rng(0)
    for _ in range(60):
        action = rng.uniform(-1, 1, 2)
        _, reward, *_, info = env.step(action)
        cost = EFFORT * (action**2).mean() * 0.1
        assert reward + cost >= -1e-9
        total += reward + cost
    assert total > 5
    assert info["seen_area"] == pytest.approx(first["seen_area"] + total)
    seen = env.episodes.stage.seen
    assert info["seen_area"] == pytest.approx(seen.seen(0).sum() * SEEN_CELL**2)
    assert 0 < info["coverage"] < 1


@pytest.mark.parametrize("robot", ["husky", "turtlebot3_burger"])
@pytest.mark.parametrize("world", ["rough", "walled"])
def test_a_robot_that_stands_earns_nothing_by_noise(
    robot: str, world: str, request: pytest.FixtureRequest
) -> None:
    env = RobotEnv("mapping", world=request.getfixturevalue(world), robot=robot, noise="datasheet")
    _, info = env.reset(seed=1)
    begin, still = info["seen_area"], np.zeros(env.action_space.shape or (), np.float32)
    rewards = []
    for _ in range(60):
        _, reward, *_, info = env.step(still)
        rewards.append(reward)
    assert rewards == [0.0] * 60
    if (world, robot) == ("rough", "husky"):
        assert info["seen_area"] > begin, "the noise shows ground"


def test_mapping_ends_when_the_reachable_ground_is_seen(walled: World) -> None:
    env = RobotEnv("mapping", world=walled)
    env.reset(seed=3)
    seen = env.episodes.stage.seen
    wanted = env.episodes.task.ground(0)[1]
    seen.wanted_cells[0] = int(0.94 * wanted.sum())
    *_, terminated, _, info = env.step(np.zeros(2))
    assert not terminated
    seen.wanted_cells[0] = math.ceil(0.95 * wanted.sum())
    *_, terminated, _, info = env.step(np.zeros(2))
    assert (terminated, info["reason"]) == (True, "covered")


def test_navigation_reward_is_the_way_gained(rough: World) -> None:
    env = RobotEnv("navigation", world=rough, observe=["goal", "scan"])
    checked = 0
    for seed in range(4):
        observation, info = env.reset(seed=seed)
        T = env.view.T_world_base
        dx, dy = info["goal"] - (T.x, T.y)
        distance, bearing = observation["goal"].tolist()
        assert distance == pytest.approx(math.hypot(dx, dy))
        assert info["distance"] == pytest.approx(distance)
        assert math.cos(bearing) == pytest.approx(math.cos(math.atan2(dy, dx) - T.yaw))
        assert info["shortest_path"] >= distance - 0.3
        gained, way = 0.0, info["shortest_path"]
        for _ in range(25):
            _, reward, terminated, _, info = env.step(AHEAD)
            if terminated:
                break
            gained += reward + EFFORT * 0.5 * 0.1
        site, T = env.episodes.stage.site, env.view.T_world_base
        left = site.distances(*info["goal"])[tuple(site.grid.cells((T.x, T.y)))]
        if not terminated and np.isfinite(left):
            # What is left of the way and what was gained make the whole.
            assert gained + left == pytest.approx(way, abs=0.6)
            checked += 1
    assert checked >= 2


def test_navigation_succeeds_at_the_goal(plane: World) -> None:
    env = RobotEnv("navigation", world=plane)
    _, info = env.reset(seed=0, options={"start": [0, 0, 0], "goal": [3, 0]})
    assert info["shortest_path"] == pytest.approx(3.0, abs=0.3)
    total = 0.0
    for _ in range(40):
        _, reward, terminated, _, info = env.step(AHEAD)
        total += reward
        if terminated:
            break
    assert (info["success"], info["reason"], info["collision"]) == (True, "success", False)
    assert info["distance"] <= 0.58
    assert total == pytest.approx(10 + 3.0 - 0.58, abs=0.5)


@pytest.mark.parametrize("robot", ["jackal", "turtlebot3_burger"])
def test_no_goal_is_reached_through_a_wall(robot: str, walled: World, T_world_wall: Pose2) -> None:
    env = RobotEnv("navigation", world=walled, robot=robot)
    task, rng = env.episodes.task, np.random.default_rng(0)
    assert isinstance(task, NavigationTask)
    env.reset(seed=0)
    radius, rows, touched = make_robot(robot).radius, np.zeros(1, np.int64), np.zeros(1, np.bool_)
    for _ in range(1000):
        y = rng.uniform(-5.0, 5.0)
        here, goal = (T_world_wall.apply((x, y)).tolist() for x in (3.0 - radius, 3.1 + radius))
        task.goals[0] = goal
        task._costs[0] = np.zeros(env.episodes.stage.site.areas.shape)
        _, ends = task.step(rows, np.array(((*here, 0.0, 0.0),)), touched)
        assert list(ends) == [""]


def test_navigation_ends_at_a_collision(walled: World) -> None:
    env = RobotEnv("navigation", world=walled)
    env.reset(seed=0, options={"start": Pose2(1.5, 0.0, 0.4), "goal": [0.0, -3.0]})
    for _ in range(60):
        _, reward, terminated, _, info = env.step(AHEAD)
        if terminated:
            break
    assert (info["collision"], info["success"], info["reason"]) == (True, False, "collision")
    assert -5.2 < reward < -4.8


def test_difficulty_lengthens_the_way_and_roughens_it(rough: World) -> None:
    ways = {}
    for difficulty in (0.0, 1.0):
        env = RobotEnv("navigation", world=rough, difficulty=difficulty)
        ways[difficulty] = np.mean([env.reset(seed=s)[1]["shortest_path"] for s in range(6)])
        assert all(env.reset(seed=s)[1]["redrawn"] < 100 for s in range(3))
    assert ways[0.0] < 4
    assert ways[1.0] > 10


def test_traverse_draws_another_course_where_no_walker_can_walk() -> None:
    env = RobotEnv("traverse", robot="turtlebot3_burger", actors=3, observe=["goal"])
    assert any(env.reset(seed=seed)[1]["redrawn"] for seed in range(50))
    crowd = RobotEnv("traverse", robot="turtlebot3_burger", actors=3, observe=["goal"], randomize=["sensor"])
    crowd.episodes.simulation.replace_terrain = refused  # type: ignore[method-assign]
    with pytest.raises(SimulationError, match="no ground"):
        crowd.reset(seed=0)


def refused(*_: object) -> None:
    raise SimulationError("no ground")


def test_traverse_progress_and_success() -> None:
    env = RobotEnv("traverse", kind="waves", difficulty=0.0, rewards={"contact": 0.0})
    observation, info = env.reset(seed=2)
    assert set(observation) == {"scan", "goal", "attitude", "height_map"}
    first, total = info["distance"], 0.0
    for _ in range(450):
        bearing = float(observation["goal"][1])
        action = np.array((1.0 if abs(bearing) < 0.5 else 0.2, np.clip(bearing, -1, 1)))
        observation, reward, terminated, truncated, info = env.step(action)
        total += reward + 0.1 * EFFORT * (action**2).mean()
        if terminated or truncated:
            break
    assert info["reason"] == "success"
    assert info["progress"] == pytest.approx(first - info["distance"])
    assert total == pytest.approx(10 + 100 * info["progress"] / first)


def test_height_map_is_the_ground_around(rough: World) -> None:
    env = RobotEnv("mapping", world=rough, observe=["height_map"])
    for seed in range(3):
        heights = env.reset(seed=seed)[0]["height_map"]
        T = env.view.T_world_base
        for row, col in ((0, 0), (10, 20), (31, 5)):
            ahead, left = (15.5 - row) * 0.2, (15.5 - col) * 0.2
            x, y = T.to_pose2().apply((ahead, left)).tolist()
            inside = rough.surface.contains(x, y)
            expected = float(rough.surface.height_at(x, y)) - T.z if inside else NO_GROUND
            assert heights[row, col] == pytest.approx(expected, abs=1e-4)


def test_height_map_has_no_ground_beyond_the_border_and_in_holes() -> None:
    holes = np.zeros((201, 201), np.bool_)
    holes[:, 110:] = True
    surface = HeightField(np.zeros((201, 201), np.float32), (0.1, 0.1), (-10.0, -10.0))
    world = World("plain", Terrain(surface, holes))
    env = RobotEnv("mapping", world=world, observe=["height_map"], randomize=[])
    heights = env.reset(options={"start": (-8.0, 0.0, 0.0)})[0]["height_map"]
    np.testing.assert_allclose(heights[:25], -env.view.T_world_base.z, atol=1e-6)
    assert (heights[26:] == NO_GROUND).all(), "behind it is the border"
    heights = env.reset(options={"start": (-1.0, 0.0, 0.0)})[0]["height_map"]
    assert (heights[:5] == NO_GROUND).all(), "ahead of it is a hole"
    assert (heights[7:] > -1).all()


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


PAGE = Path(__file__).parents[3] / "docs" / "howto" / "policy.md"


@pytest.fixture
def wander() -> Iterator[str]:
    """Run the how-to's program, which registers a task and an environment."""
    section = PAGE.read_text().partition("## A task of your own")[2]
    program = re.findall(r"```python\n(.*?)```", section, re.DOTALL)[0]
    exec(program, {})
    yield "Mine/Wander-v0"
    del TASKS["wander"], gym.registry["Mine/Wander-v0"]


def test_the_task_of_the_how_to(wander: str, plane: World) -> None:
    env = gym.make(wander, world=plane, time_limit=2.0)
    vector = gym.make_vec(
        wander, num_envs=2, vectorization_mode="vector_entry_point", world=plane, time_limit=2.0
    )
    _, first = env.reset(seed=4)
    vector.reset(seed=4)
    ahead, truncated, earned = np.array((1.0, 0.0), np.float32), False, 0.0
    while not truncated:
        _, reward, terminated, truncated, info = env.step(ahead)
        _, rewards, *_ = vector.step(np.tile(ahead, (2, 1)))
        assert rewards[0] == reward
        assert not terminated
        earned += float(reward) + 0.1 * 0.1 / 2
    driven: Any = np.hypot(*(info["T_world_base"] - first["T_world_base"])[:2])
    assert earned == pytest.approx(driven, rel=1e-3)
    assert info["reason"] == "timeout"


def test_a_task_keeps_its_name() -> None:
    before = dict(TASKS)
    register_task("mapping", MappingTask)
    for name, task, message in (
        ("mapping", NavigationTask, "belongs to another task, MappingTask"),
        ("other", dict, "subclass of lirs_envs.tasks.task.Task"),
        ("other", "Task", "subclass of lirs_envs.tasks.task.Task"),
    ):
        with pytest.raises(ConfigError, match=message):
            register_task(name, task)  # type: ignore[arg-type]
    assert before == TASKS
