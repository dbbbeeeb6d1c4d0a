"""Observation groups with a state for each robot."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from lirs_envs.env import RobotEnv
from lirs_envs.episodes.observations import GROUPS, SCANS, Group
from lirs_envs.tasks.task import Stage, Task
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
