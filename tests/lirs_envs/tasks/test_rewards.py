"""Accidents are never cheaper than collisions, contact has a limit, and weights are options."""

from typing import Any

import numpy as np
import pytest

from lirs_envs.env import RobotEnv
from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import LaserMap
from lirs_wct.sources.laser_map import level_floor
from lirs_wct.world import World
from tests.kit import refused

AHEAD, STILL = np.array((1.0, 0.0), np.float32), np.zeros(2, np.float32)
TASKS = ("mapping", "navigation", "traverse")


def turn_over(env: RobotEnv) -> None:
    env.episodes.simulation.states[0].qpos[2] += 1.0
    env.episodes.simulation.states[0].qpos[3:7] = (0.0, 1.0, 0.0, 0.0)


def test_tipping_over_at_the_goal_is_no_success(plane: World) -> None:
    env = RobotEnv("navigation", observe=["attitude"], world=plane)
    _, info = env.reset(seed=1, options={"start": Pose2(), "goal": (3.0, 0.0)})
    env.episodes.simulation.states[0].qpos[:2] = (3.0, 0.0)
    turn_over(env)
    _, _, terminated, _, info = env.step(STILL)
    assert (terminated, info["reason"], bool(info["success"])) == (True, "tipped over", False)
    assert info["distance"] < 0.5


def options_of(task: str, world: World) -> dict[str, Any]:
    return {"observe": ["attitude"]} | ({} if task == "traverse" else {"world": world})


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize(("weights", "cost"), [({}, 10.0), ({"tipped": -25.0}, 25.0)])
def test_tipping_over_costs_more_than_a_collision(
    task: str, weights: dict[str, float], cost: float, plane: World
) -> None:
    env = RobotEnv(task, rewards=weights, **options_of(task, plane))
    env.reset(seed=1)
    turn_over(env)
    _, reward, terminated, _, info = env.step(STILL)
    assert (terminated, info["reason"]) == (True, "tipped over")
    assert reward == pytest.approx(-cost, abs=0.5)


@pytest.mark.parametrize("task", ["mapping", "navigation"])
def test_leaving_a_terrain_costs_more_than_a_collision(task: str, plane: World) -> None:
    env = RobotEnv(task, world=plane, observe=["attitude"])
    env.reset(seed=0, options={"start": [8.5, 0, 0]})
    terminated, rewards = False, []
    while not terminated:
        _, reward, terminated, _, info = env.step(AHEAD)
        rewards.append(reward)
    assert info["reason"] == "left the world"
    assert rewards[-1] < -9.5
    assert min(rewards[:-1]) > -1


def open_map(yaw: float, hole: bool) -> World:
    """Return a map of 6 m whose free space reaches its border, but for one pillar."""
    solid, holes = np.zeros((120, 120), np.bool_), np.zeros((120, 120), np.bool_)
    solid[30:34, 30:34] = True
    holes[:2, 50:60] = hole
    walls = WallGrid(solid, 0.05, Pose2(1.0, 2.0, yaw), 1.0, holes if hole else None)
    return World("open", LaserMap(level_floor(walls), walls), spawn_poses=(Pose2(*middle(walls), 0.0),))


def middle(walls: WallGrid) -> tuple[float, float]:
    x, y = walls.corners.mean(axis=0).tolist()
    return x, y


@pytest.mark.parametrize(("yaw", "hole"), [(0.0, False), (0.7, False), (0.0, True)])
def test_the_border_of_a_map_is_a_wall(yaw: float, hole: bool) -> None:
    world = open_map(yaw, hole)
    assert world.walls is not None
    x, y = middle(world.walls)
    envs = RobotVectorEnv(8, "mapping", world=world, robot="turtlebot2", time_limit=6, observe=["scan"])
    for i in range(8):
        envs.episodes.reset(i, np.random.default_rng(i), {"start": [x, y, yaw + i * np.pi / 4]})
    ids, touched = np.arange(8), np.zeros(8, np.bool_)
    ranges = envs.episodes.parts[0].simulation.ranges
    assert np.isfinite(ranges).all(), "every beam meets the border or the pillar"
    while not envs.episodes.truncated.any():
        envs.episodes.step(ids, np.tile(AHEAD, (8, 1)))
        touched |= envs.episodes.infos()["contact"]
        assert not envs.episodes.terminated.any(), envs.episodes.infos()["reason"]
    assert touched.all()


def test_walls_are_enclosed_once(walled: World) -> None:
    enclosed = walled.walls.enclose()
    rows, cols = walled.walls.shape
    assert enclosed.enclose() is enclosed
    assert enclosed.shape == (rows + 2, cols + 2)
    np.testing.assert_array_equal(enclosed.solid[1:-1, 1:-1], walled.walls.solid)
    assert (~enclosed.solid).sum() == (~walled.walls.solid).sum()
    outer = np.array(((-1, -1), (cols + 1, -1), (cols + 1, rows + 1), (-1, rows + 1)))
    expected = walled.walls.origin.apply(outer * walled.walls.resolution)
    np.testing.assert_allclose(enclosed.corners, expected, atol=1e-12)
    closed = World("closed", LaserMap(walled.surface, enclosed))
    assert closed.enclose() is closed
    terrain = HeightField.centered(np.zeros((3, 3), np.float32), (1.0, 1.0))
    assert World("map", LaserMap(terrain, walled.walls)).enclose().walls.shape == enclosed.shape  # type: ignore[union-attr]


def test_contact_costs_no_more_than_a_collision(walled: World, T_world_wall: Pose2) -> None:
    x, y = T_world_wall.apply((1.5, 0.0)).tolist()
    spent = {}
    for limit in (-5.0, -2.0):
        env = RobotEnv("mapping", world=walled, time_limit=6, rewards={"collision": limit, "effort": 0.0})
        for _ in range(2):
            env.reset(seed=0, options={"start": [x, y, T_world_wall.yaw]})
            costs, seconds, truncated = 0.0, 0.0, False
            area = env.episodes.task.infos()["seen_area"][0]
            while not truncated:
                _, reward, terminated, truncated, info = env.step(AHEAD)
                assert not terminated
                costs += reward - (info["seen_area"] - area)
                area, seconds = info["seen_area"], seconds + 0.1 * info["contact"]
            assert seconds > 2
        spent[limit] = costs
    assert spent == pytest.approx({-5.0: -5.0, -2.0: -2.0})


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"tiped": -1.0}, "unknown reward 'tiped'; legal: collision, contact, crossing, effort, left"),
        ({"collision": 5.0}, "collision of the rewards must be within"),
        ({"collision": float("nan")}, "collision of the rewards must be within"),
        ({"success": -1.0}, "success of the rewards"),
        ({"tipped": -1.0}, "tipped of the rewards must be at most that of a collision, -5, got -1"),
        ({"collision": -20.0}, "tipped of the rewards must be at most that of a collision, -20, got -10"),
        ({"left": 0.0}, "left of the rewards must be"),
        ({"effort": "much"}, "effort of the rewards must be within"),
        ([("tipped", -9.0)], "mapping of names to weights"),
    ],
)
def test_bad_weights_get_one_line(weights: Any, message: str) -> None:
    with refused(words=message, kind=ConfigError):
        RobotEnv("traverse", rewards=weights)
