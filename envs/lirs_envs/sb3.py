"""Adapter from Gymnasium vector environments to the `VecEnv` of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from lirs_envs.env import RobotEnv
from lirs_envs.episodes.episodes import EpisodeView
from lirs_envs.vector_env import RobotVectorEnv, split_infos
from lirs_wct import ByteArray, ConfigError

PICTURES = {None: None, "rgb_array": "rgb_array", "map": "rgb_array"}
"""Render modes and their names in Stable-Baselines3."""


def as_vec_env(*vectors: VectorEnv[Any, Any, Any]) -> Any:
    """Return vector environments as one `VecEnv` of Stable-Baselines3.

    Args:
        *vectors: Vectors of `gym.make_vec` in this process, wrapped or not, with autoreset mode `SameStep`,
            as Stable-Baselines3 resets; several of them (say, each in a world of its own) have the same
            spaces, and their environments are numbered one after the other.

    At the end of an episode `info["episode"]` has its return `r`, steps `l` and simulated seconds `t`, which
    Stable-Baselines3 logs and `evaluate_policy` returns, as from its `Monitor`.

    A vector with render mode `map` shows as one with `rgb_array`, the one kind of picture that
    Stable-Baselines3 knows.

    Raises:
        ConfigError: Stable-Baselines3 is not installed, a vector is none of this package in this process, the
            autoreset or render mode is none for it, or the vectors differ in spaces or render mode.
    """
    try:
        base: Any = import_module("stable_baselines3.common.vec_env").VecEnv
    except ImportError:
        raise ConfigError("as_vec_env needs Stable-Baselines3: pip install 'lirs-wct[rl]'") from None
    if not vectors:
        raise ConfigError("as_vec_env needs at least one vector environment")
    for one in vectors:
        _check(one, vectors[0])
    # The class is created on demand because the package is optional.
    return type("RobotVecEnv", (_RobotVecEnv, base), {})(vectors)


def _views(vector: Any) -> Sequence[EpisodeView]:
    """Return the view of each environment of a vector, below its wrappers."""
    inner: Any = getattr(vector, "unwrapped", vector)
    if isinstance(inner, RobotVectorEnv):
        return inner.views
    if isinstance(inner, SyncVectorEnv) and inner.copy:
        robots: list[Any] = [env.unwrapped for env in inner.envs]
        if all(isinstance(robot, RobotEnv) for robot in robots):
            return [robot.view for robot in robots]
    raise ConfigError(
        "as_vec_env needs vectors of gym.make_vec('LIRS/...') with vectorization_mode vector_entry_point or "
        f"sync (and copy=True), got {type(inner).__name__}"
    )


def _check(one: VectorEnv[Any, Any, Any], first: VectorEnv[Any, Any, Any]) -> None:
    _views(one)
    if one.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
        raise ConfigError(
            "Stable-Baselines3 resets in the step that ends an episode: make the vector environment with "
            f"autoreset_mode='SameStep', got {one.metadata.get('autoreset_mode')}"
        )
    if one.render_mode not in PICTURES:
        raise ConfigError(f"Stable-Baselines3 shows render modes rgb_array and map, got {one.render_mode!r}")
    for name in ("single_observation_space", "single_action_space", "render_mode"):
        wanted, got = getattr(first, name), getattr(one, name)
        if got != wanted:
            raise ConfigError(f"all vectors of a VecEnv need the same {name}, got {wanted} and {got}")


class _RobotVecEnv:
    """Adapter of N robots to Stable-Baselines3's `VecEnv`, without its base class.

    Attributes:
        vectors: vector environments, numbered one after the other.
        reset_infos: infos of each environment's last reset.
    """

    num_envs: int
    _seeds: list[int | None]
    _options: list[dict[str, Any]]
    _get_indices: Callable[[Any], Iterable[int]]
    _reset_seeds: Callable[[], None]
    _reset_options: Callable[[], None]

    def __init__(self, vectors: Sequence[Any]) -> None:
        self.vectors = tuple(vectors)
        self.reset_infos: list[dict[str, Any]] = []
        self._views = [view for one in vectors for view in _views(one)]
        self._ends = np.cumsum([one.num_envs for one in vectors])[:-1].tolist()
        self._actions: Any = None
        self._returns, self._lengths = np.zeros(len(self._views)), np.zeros(len(self._views), np.int64)
        spaces = vectors[0].single_observation_space, vectors[0].single_action_space
        super().__init__(len(self._views), *spaces)  # type: ignore[call-arg]

    def reset(self) -> Any:
        """Begin an episode of each environment; return the observations."""
        observed = []
        self.reset_infos = []
        self._returns[:], self._lengths[:] = 0.0, 0
        for one, rows in zip(self.vectors, self._split(np.arange(self.num_envs)), strict=True):
            seeds = [self._seeds[i] for i in rows]
            known = any(seed is not None for seed in seeds)
            options = self._options[rows[0]]
            if any(self._options[i] != options for i in rows):
                raise ConfigError("all environments of a vector take the same options of a reset")
            observation, infos = one.reset(seed=seeds if known else None, options=options or None)
            observed.append(observation)
            self.reset_infos += split_infos(infos, one.num_envs)
        self._reset_seeds()
        self._reset_options()
        return _join(observed)

    def _split(self, rows: Any) -> list[Any]:
        return np.split(rows, self._ends)

    def step_async(self, actions: Any) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Apply the actions; return observations, rewards, ends and infos."""
        steps = [
            one.step(actions) for one, actions in zip(self.vectors, self._split(self._actions), strict=True)
        ]
        observed, rewards, terminated, truncated, infos = zip(*steps, strict=True)
        rows = [
            row
            for one, found in zip(self.vectors, infos, strict=True)
            for row in split_infos(found, one.num_envs)
        ]
        done, late = np.concatenate(terminated), np.concatenate(truncated)
        self._returns += np.concatenate(rewards)
        self._lengths += 1
        for i, row in enumerate(rows):
            if done[i] or late[i]:
                left_out = ("final_obs", "final_info", "episode")
                self.reset_infos[i] = {k: value for k, value in row.items() if k not in left_out}
                rows[i] = row["final_info"] | {"terminal_observation": row["final_obs"]}
                rows[i]["episode"] = {
                    "r": float(self._returns[i]),
                    "l": int(self._lengths[i]),
                    "t": float(rows[i]["time"]),
                }
                self._returns[i], self._lengths[i] = 0.0, 0
            rows[i]["TimeLimit.truncated"] = bool(late[i] and not done[i])
        return _join(observed), np.concatenate(rewards).astype(np.float32), done | late, rows

    def close(self) -> None:
        for one in self.vectors:
            one.close()

    def get_images(self) -> Sequence[ByteArray | None]:
        return [image for one in self.vectors for image in one.render() or [None] * one.num_envs]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        rows = self._get_indices(indices)
        if attr_name == "render_mode":
            return [PICTURES[self.vectors[0].render_mode] for _ in rows]
        return [getattr(self._views[i], attr_name) for i in rows]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        for i in self._get_indices(indices):
            setattr(self._views[i], attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        rows = self._get_indices(indices)
        return [getattr(self._views[i], method_name)(*args, **kwargs) for i in rows]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        # Stable-Baselines3 takes true returns from `info["episode"]` where its `Monitor` is.
        return [wrapper_class.__name__ == "Monitor" for _ in self._get_indices(indices)]


def _join(observations: Sequence[Any]) -> Any:
    """Return the observations of several vectors as those of one."""
    if len(observations) == 1:
        return observations[0]
    if not isinstance(observations[0], dict):
        return np.concatenate(observations)
    return {name: np.concatenate([one[name] for one in observations]) for name in observations[0]}
