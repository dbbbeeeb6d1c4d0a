"""Pushes, latency and slip: disturbances during an episode."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest

from lirs_envs.env import RobotEnv
from lirs_envs.episodes.episodes import INTERVAL
from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.world import World

STILL, AHEAD = np.zeros(2, np.float32), np.array((1.0, 0.0), np.float32)
EXACT: dict[str, Any] = {"observe": ["odometry"], "noise": "none", "time_limit": 1e6}


def made(world: World, randomize: Any, **options: Any) -> RobotEnv:
    return RobotEnv("mapping", world=world, randomize=randomize, **(EXACT | options))


def speeds(env: RobotEnv, steps: int) -> np.ndarray:
    """Return the changes of a standing robot's speed before each step."""
    randomization, found = env.episodes._randomization, []
    disturb = randomization.disturb

    def recorded(ids: Any) -> None:
        before = env.episodes.simulation.states[0].qvel[:2].copy()
        disturb(ids)
        found.append(np.hypot(*(env.episodes.simulation.states[0].qvel[:2] - before)))

    randomization.disturb = recorded  # type: ignore[method-assign]
    for _ in range(steps):
        env.step(STILL)
    return np.array(found)


def test_pushes_come_at_random_times_and_have_sizes_in_their_range(plane: World) -> None:
    env = made(plane, {"pushes": [0.2, 0.3]}, control_hz=5)
    env.reset(seed=0)
    start, changes = env.view.T_world_base, speeds(env, 500)
    pushes = changes[changes > 0]
    assert ((pushes >= 0.2 - 1e-9) & (pushes <= 0.3 + 1e-9)).all()
    assert np.ptp(pushes) > 0.05
    assert len(pushes) == pytest.approx(100 / INTERVAL, rel=0.5)
    assert np.ptp(np.diff(np.flatnonzero(changes))) > 10
    end = env.view.T_world_base
    assert np.hypot(end.x - start.x, end.y - start.y) > 0.005
    calm = made(plane, ["mass"], control_hz=5)
    calm.reset(seed=0)
    assert not speeds(calm, 50).any()


def test_an_action_takes_effect_after_the_latency(plane: World) -> None:
    prompt = made(plane, [])
    body = prompt.episodes.simulation.body
    late = made(plane, {"latency": [0.2, 0.2]})
    ways = []
    for env in (prompt, late):
        env.reset(seed=0)
        ways.append([env.step(action)[-1]["T_world_base"] for action in [AHEAD] * 8 + [STILL] * 12])
    assert len(body.substeps) * max(body.substeps) * body.timestep == pytest.approx(0.1, abs=0.01)
    moved = [np.hypot(*(np.array(way)[:, :2] - way[0][:2]).T) for way in ways]
    assert moved[1][:2] == pytest.approx(0.0, abs=1e-3)
    assert moved[1][2:] == pytest.approx(moved[0][:-2] + ways[0][0][0] - ways[1][0][0], abs=0.02)
    assert moved[0][-1] > 0.3


@pytest.mark.parametrize(("robot", "odometry"), [("husky", "gyro"), ("husky", "ekf"), ("quadrotor", "gyro")])
def test_slip_lengthens_the_measured_distance(robot: str, odometry: str, plane: World) -> None:
    measured = []
    for share in (0.0, 0.1):
        env = made(plane, {"slip": [share, share]}, robot=robot, odometry=odometry)
        env.reset(seed=0)
        for _ in range(30):
            observation, *_ = env.step(np.resize(AHEAD, env.action_space.shape))
        measured.append(observation["odometry"][0])
    assert measured[1] / measured[0] == pytest.approx(1.1, abs=0.005)


def test_rows_equal_single_environments_and_copies(plane: World, rough: World) -> None:
    """Over episodes, threads and several worlds; copies in mid-episode go on bit for bit."""
    names = dict.fromkeys(("pushes", "latency", "slip"), (0.1, 0.5))
    options: dict[str, Any] = {"randomize": names | {"start": None}, "time_limit": 1.5}
    options["observe"] = ["scans", "odometry", "goal"]
    vector = RobotVectorEnv(
        6, "navigation", world=[plane, rough], threads=2, autoreset_mode="SameStep", **options
    )
    singles = [RobotEnv("navigation", world=world, **options) for world in (plane,) * 3 + (rough,) * 3]
    together, _ = vector.reset(seed=5)
    alone = [env.reset(seed=5 + i)[0] for i, env in enumerate(singles)]
    rng, ends = np.random.default_rng(0), 0
    for k in range(24):
        if k == 8:
            vector, singles = pickle.loads(pickle.dumps(vector)), copy.deepcopy(singles)
        actions = rng.uniform(-1, 1, (6, 2)).astype(np.float32)
        together, rewards, *_ = vector.step(actions)
        for i, env in enumerate(singles):
            alone[i], reward, *over, _ = env.step(actions[i])
            assert reward == rewards[i]
            if any(over):
                alone[i], ends = env.reset()[0], ends + 1
            for group in alone[i]:
                np.testing.assert_array_equal(together[group][i], alone[i][group])
    assert ends >= 6
