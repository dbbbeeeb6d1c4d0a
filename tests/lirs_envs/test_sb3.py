"""The adapter to Stable-Baselines3: against its interface, and against itself where it is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lirs_envs.sb3 import _adapter, as_vec_env, split_infos
from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.errors import ConfigError


class VecEnvInterface:
    """What the adapter uses of Stable-Baselines3's `VecEnv`, version 2."""

    def __init__(self, num_envs: int, observation_space: Any, action_space: Any) -> None:
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]
        self._seeds: list[int | None] = [None] * num_envs
        self._options: list[dict[str, Any]] = [{} for _ in range(num_envs)]
        self.render_mode = self.get_attr("render_mode")[0]  # type: ignore[attr-defined]

    def seed(self, seed: int) -> list[int | None]:
        self._seeds = [seed + i for i in range(self.num_envs)]
        return self._seeds

    def _reset_seeds(self) -> None:
        self._seeds = [None] * self.num_envs

    def _reset_options(self) -> None:
        self._options = [{} for _ in range(self.num_envs)]

    def step(self, actions: Any) -> Any:
        self.step_async(actions)  # type: ignore[attr-defined]
        return self.step_wait()  # type: ignore[attr-defined]


def vector(**options: Any) -> RobotVectorEnv:
    return RobotVectorEnv(
        3, "navigation", autoreset_mode="SameStep", threads=1, world="simple", time_limit=0.5, **options
    )


def test_steps_are_those_of_the_vector() -> None:
    adapted, plain = _adapter(VecEnvInterface)(vector()), vector()
    adapted.seed(5)
    first, (second, infos) = adapted.reset(), plain.reset(seed=5)
    assert first["scan"].tobytes() == second["scan"].tobytes()
    assert adapted.reset_infos[1]["goal"].tolist() == infos["goal"][1].tolist()
    rng = np.random.default_rng(0)
    for step in range(1, 12):
        actions = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        observation, rewards, done, rows = adapted.step(actions)
        expected = plain.step(actions)
        assert observation["scan"].tobytes() == expected[0]["scan"].tobytes()
        assert rewards == pytest.approx(expected[1])
        assert rewards.dtype == np.float32
        assert done.tolist() == (expected[2] | expected[3]).tolist()
        for i in range(3):
            if not done[i]:
                assert "terminal_observation" not in rows[i]
                continue
            assert step % 5 == 0
            assert rows[i]["TimeLimit.truncated"] is True
            assert rows[i]["reason"] == "timeout"
            assert rows[i]["time"] == pytest.approx(0.5)
            final = rows[i]["terminal_observation"]
            assert final["scan"].tobytes() == expected[4]["final_obs"][i]["scan"].tobytes()
            assert final["scan"].tobytes() != observation["scan"][i].tobytes()
            assert adapted.reset_infos[i]["time"] == 0.0


def test_attributes_and_methods_of_chosen_environments() -> None:
    adapted = _adapter(VecEnvInterface)(vector())
    adapted.reset()
    adapted.set_attr("difficulty", 0.9, indices=[0, 2])
    assert adapted.get_attr("difficulty") == [0.9, 0.5, 0.9]
    assert len(adapted.env_method("reading", indices=1)) == 1
    assert adapted.env_is_wrapped(object) == [False] * 3


def test_split_infos() -> None:
    infos = {"a": np.array((1, 2)), "_a": np.array((True, False)), "b": {"c": np.array((3.0, 4.0))}}
    infos["b"]["_c"] = np.array((False, True))
    infos["_b"] = np.array((True, True))
    assert split_infos(infos, 2) == [{"a": 1, "b": {}}, {"b": {"c": 4.0}}]


def test_what_cannot_be(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    with pytest.raises(ConfigError, match=r"pip install 'lirs-wct\[rl\]'"):
        as_vec_env(vector())


def test_stable_baselines_takes_it() -> None:
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO

    with pytest.raises(ConfigError, match="autoreset_mode='SameStep'"):
        as_vec_env(RobotVectorEnv(2, "navigation", world="simple"))
    model = PPO("MultiInputPolicy", as_vec_env(vector()), n_steps=16, batch_size=16, n_epochs=1)
    model.learn(96)
