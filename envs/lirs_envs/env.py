"""The Gymnasium environment: one robot in one world, with a task."""

from __future__ import annotations

import copy
import inspect
from dataclasses import fields
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import TimeLimit

from lirs_envs.episodes.config import EnvConfig
from lirs_envs.episodes.episodes import Episodes, EpisodeView
from lirs_envs.rendering import RENDER_MODES, Snapshot, Views, check_render_mode
from lirs_wct import ByteArray, Float32Array, Pose2
from lirs_wct.errors import OptionError, did_you_mean

Observed = dict[str, Any]
ROW = np.zeros(1, np.int64)


class LimitedEpisodes:
    """Environment whose `spec` holds its limit of steps, which Gymnasium's time wrappers read."""

    episodes: Any
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Specification from which the environment was made; None = it was made directly."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = copy.copy(spec)
        if self._spec is not None:
            self._spec.max_episode_steps = self.episodes.max_steps


class RobotEnv(LimitedEpisodes, gym.Env[Observed, Float32Array]):
    """One robot with a task; bit-equal to one row of the vector environment.

    Observation: a dict of the groups in `observe` (see `lirs_envs.episodes.observations.GROUPS`).

    Action: (2,) in [-1, 1]: speed ahead and turn rate, as shares of the robot's largest. A flying robot has
    (3,): shares of 3 m/s, 1.5 rad/s and a climb of 1 m/s.

    Reward: reward of the task, and costs of contact, effort and accidents (see
    `lirs_envs.tasks.task.Rewards`).

    Terminated: by the task, tipped over, left the world, or the simulation diverged (`info["error"]`). The
    reason is `info["reason"]`. Truncated: the time is up.

    `view` holds unobserved state: true pose, world, goal, and `reading()` as arguments of a mapper.
    `reset(options=...)` takes the options that the task lists in `option_names`.

    Args:
        task: `mapping`, `navigation` or `traverse`.
        kind: kind of course, for the traverse task only; None = `mixed`.
        render_mode: `human`, `rgb_array`, `depth_array`, `map` (see `lirs_envs.rendering`) or None.
        **options: fields of `EnvConfig`.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012  Gymnasium's contract

    def __init__(
        self, task: str, *, kind: str | None = None, render_mode: str | None = None, **options: Any
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self.episodes: Episodes = Episodes(task, make_config(options), 1, kind=kind)
        self.metadata = self.metadata | {"render_fps": round(self.episodes.config.control_hz)}
        self.action_space = self.episodes.action_space
        self.observation_space = self.episodes.observations.space
        self.view = EpisodeView(self.episodes, 0)
        self._views = Views()
        self._path: list[Pose2] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin an episode (see `Episodes.reset`)."""
        super().reset(seed=seed)
        self.episodes.limit_steps(self._find_limit())
        self.episodes.reset(0, self.np_random, options)
        self._path.clear()
        self._show()
        return self._observe(), self._info()

    def step(self, action: Float32Array) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Apply an action for one period (see `Episodes.step`)."""
        episodes = self.episodes
        reward = episodes.step(ROW, [action])
        ended = bool(episodes.terminated[0]), bool(episodes.truncated[0])
        self._show()
        return self._observe(), float(reward[0]), *ended, self._info()

    @property
    def difficulty(self) -> float:
        """Difficulty of the next episode, 0 to 1; settable."""
        return self.view.difficulty

    @difficulty.setter
    def difficulty(self, value: float) -> None:
        self.view.difficulty = value

    def render(self) -> ByteArray | Float32Array | None:
        """Return the picture of the render mode (see `lirs_envs.rendering.Views.render`).

        The path on a map joins the poses at calls of `render`.
        """
        if self.render_mode is None:
            return None
        snapshot, scan = snapshot_of(self.episodes, 0), self.view.reading().scan
        self._path.append(snapshot.T_world_base.to_pose2())
        return self._views.render(self.render_mode, snapshot, path=self._path, scan=scan)

    def _show(self) -> None:
        """Show each state if the render mode is a window, like Gymnasium's environments."""
        if self.render_mode == "human":
            self.render()

    def close(self) -> None:
        """Release OpenGL resources and close the window."""
        self._views.close()

    def _find_limit(self) -> int | None:
        """Return the steps of the `TimeLimit` that resets this environment; None = there is none.

        `gym.make` gives `max_episode_steps` to that wrapper alone, and `info` is to tell a timeout.
        """
        frame, limits = inspect.currentframe(), []
        while frame is not None:
            # Reading the variables of other frames would keep them alive.
            if frame.f_code is TimeLimit.reset.__code__:
                wrapper = frame.f_locals["self"]
                if wrapper.unwrapped is self:
                    limits.append(wrapper._max_episode_steps)
            frame = frame.f_back
        return min(limits, default=None)

    def _observe(self) -> Observed:
        return {name: values[0] for name, values in self.episodes.observations.read(ROW).items()}

    def _info(self) -> dict[str, Any]:
        infos = self.episodes.infos()
        info = {k: v[0].copy() if v.ndim > 1 else v.item(0) for k, v in infos.items()}
        error = self.episodes.simulation.errors[0]
        return info | {"error": error} if error else info


def make_config(options: dict[str, Any], *others: str) -> EnvConfig:
    """Return the config of an environment's options; a message lists `others` as legal names, too."""
    own = [field.name for field in fields(EnvConfig) if field.init]
    for name in options:
        if name not in own:
            legal = sorted([*own, "kind", "render_mode", *others])
            raise OptionError(
                f"the environment got an unexpected keyword argument {name!r}; "
                f"legal: {', '.join(legal)}{did_you_mean(name, legal)}"
            )
    return EnvConfig(**options)


def snapshot_of(episodes: Episodes, i: int) -> Snapshot:
    """Return the snapshot of episode `i` for rendering."""
    goal = EpisodeView(episodes, i).goal
    return Snapshot.of(episodes.simulation, i, None if goal is None else Pose2(*goal))
