"""Stable-Baselines3 takes no Gymnasium vector environments: this adapter makes one a `VecEnv` of its own."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from lirs_envs.vector_env import RobotVectorEnv
from lirs_wct.errors import ConfigError


def as_vec_env(envs: RobotVectorEnv) -> Any:
    """Return a vector environment as Stable-Baselines3's `VecEnv`.

    Args:
        envs: with autoreset mode `SameStep`, as Stable-Baselines3 resets.

    Raises:
        ConfigError: Stable-Baselines3 is not installed, or the autoreset mode is another.
    """
    try:
        base: Any = import_module("stable_baselines3.common.vec_env").VecEnv
    except ImportError:
        raise ConfigError("as_vec_env needs Stable-Baselines3: pip install 'lirs-wct[rl]'") from None
    if envs.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
        raise ConfigError(
            "Stable-Baselines3 resets in the step that ends an episode: make the vector environment with "
            f"autoreset_mode='SameStep', got {envs.metadata.get('autoreset_mode')}"
        )
    return _adapter(base)(envs)


def _adapter(base: Any) -> Any:
    """Return the adapter as a subclass of `VecEnv`, which is not there where the package is missing."""

    class RobotVecEnv(base):
        """N robots as Stable-Baselines3 steps them."""

        def __init__(self, envs: RobotVectorEnv) -> None:
            self.envs = envs
            self._actions: Any = None
            super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

        def reset(self) -> Any:
            seeds = None if all(seed is None for seed in self._seeds) else self._seeds
            observation, infos = self.envs.reset(seed=seeds, options=self._common_options())
            self.reset_infos = split_infos(infos, self.num_envs)
            self._reset_seeds()
            self._reset_options()
            return observation

        def _common_options(self) -> Any:
            options = self._options[0]
            if any(other != options for other in self._options):
                raise ConfigError("all environments of a vector take the same options of a reset")
            return options or None

        def step_async(self, actions: Any) -> None:
            self._actions = actions

        def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
            observation, rewards, terminated, truncated, infos = self.envs.step(self._actions)
            done = terminated | truncated
            rows = split_infos(infos, self.num_envs)
            for i in np.flatnonzero(done).tolist():
                self.reset_infos[i] = {k: v for k, v in rows[i].items() if not k.startswith("final_")}
                rows[i] = dict(rows[i]["final_info"])
                rows[i]["terminal_observation"] = infos["final_obs"][i]
            for i in range(self.num_envs):
                rows[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
            return observation, rewards.astype(np.float32), done, rows

        def close(self) -> None:
            self.envs.close()

        def get_images(self) -> Sequence[Any]:
            return list(self.envs.render() or ())

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            if attr_name == "render_mode":
                return [self.envs.render_mode for _ in self._rows(indices)]
            return [getattr(self.envs.views[i], attr_name) for i in self._rows(indices)]

        def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
            for i in self._rows(indices):
                setattr(self.envs.views[i], attr_name, value)

        def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
            return [getattr(self.envs.views[i], method_name)(*args, **kwargs) for i in self._rows(indices)]

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
            return [False for _ in self._rows(indices)]

        def _rows(self, indices: Any) -> list[int]:
            if indices is None:
                return list(range(self.num_envs))
            return [indices] if isinstance(indices, int) else list(indices)

    return RobotVecEnv


def split_infos(infos: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Return a vector's infos as one dict for each environment, of the keys that it has."""
    rows: list[dict[str, Any]] = [{} for _ in range(count)]
    for name, values in infos.items():
        mask = infos.get(f"_{name}")
        if mask is None:
            continue
        parts = split_infos(values, count) if isinstance(values, dict) else values
        for i in np.flatnonzero(mask).tolist():
            rows[i][name] = parts[i]
    return rows
