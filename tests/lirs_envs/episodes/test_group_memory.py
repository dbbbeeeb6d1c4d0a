"""Observation groups with a state for each robot."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from lirs_envs.env import RobotEnv
from lirs_envs.episodes.observations import GROUPS, SCANS, Group
from lirs_envs.tasks.task import Stage, Task
from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.world import World


def test_the_history_holds_the_last_scans(rough: World) -> None:
    env = RobotEnv("mapping", world=rough, observe=["scan", "scans"])
    rng = np.random.default_rng(0)
    for seed in range(2):
        observation, _ = env.reset(seed=seed)
        seen = [observation["scan"]] * SCANS
        for _ in range(SCANS + 2):
            np.testing.assert_array_equal(observation["scans"], seen[:SCANS])
            assert env.observation_space.contains(observation)
            observation, *_ = env.step(rng.uniform(-1, 1, 2).astype(np.float32))
            seen.insert(0, observation["scan"])
    assert not (observation["scans"][0] == observation["scans"][1]).all()


def test_rows_of_a_vector_remember_what_single_environments_do(plane: World) -> None:
    """Also across episodes that end at different steps."""
    options: dict[str, Any] = {"world": plane, "observe": ["scans"], "noise": "none", "difficulty": 0.0}
    vector = RobotVectorEnv(3, "navigation", autoreset_mode="SameStep", **options)
    singles = [RobotEnv("navigation", **options) for _ in range(3)]
    together, _ = vector.reset(seed=7)
    alone = [env.reset(seed=7 + i)[0] for i, env in enumerate(singles)]
    ends, actions = 0, np.array(((1.0, 0.0), (0.9, 0.05), (0.0, 0.5)), np.float32)
    for _ in range(70):
        for i in range(3):
            np.testing.assert_array_equal(together["scans"][i], alone[i]["scans"])
        together, _, terminated, _, infos = vector.step(actions)
        for i, env in enumerate(singles):
            alone[i], _, over, *_ = env.step(actions[i])
            assert over == terminated[i]
            if over:
                np.testing.assert_array_equal(infos["final_obs"][i]["scans"], alone[i]["scans"])
                alone[i], ends = env.reset()[0], ends + 1
    assert ends > 0


class Steps:
    """Steps since the start of an episode."""

    def __init__(self, stage: Stage, task: Task) -> None:
        self._steps = np.full((stage.count, 1), -1.0)

    def begin(self, i: int) -> None:
        self._steps[i] = 0

    def step(self, ids: Any) -> None:
        self._steps[ids] += 1

    def read(self, ids: Any) -> Any:
        return self._steps[ids]


@pytest.fixture
def steps_group(monkeypatch: pytest.MonkeyPatch) -> None:
    group = Group(lambda stage: spaces.Box(0, np.inf, (1,)), memory=Steps, privileged=True)
    monkeypatch.setitem(GROUPS, "steps", group)


@pytest.mark.usefixtures("steps_group")
def test_a_group_of_the_users_own_has_a_state(plane: World) -> None:
    env = gym.make("LIRS/Navigation-v1", world=plane, observe=["steps"])
    for seed in range(2):
        observation, _ = env.reset(seed=seed)
        assert observation["steps"] == [0]
        for k in range(1, 4):
            observation, *_ = env.step(np.zeros(2, np.float32))
            assert observation["steps"] == [k]
