"""The Gymnasium environment: one robot in one world, with a task."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import mujoco
import numpy as np

from lirs_envs.episodes.config import EnvConfig
from lirs_envs.episodes.episodes import Episodes, EpisodeView
from lirs_envs.tasks.traverse import MIXED
from lirs_wct.arrays import ByteArray, Float32Array
from lirs_wct.errors import ConfigError, SimulationError

Observed = dict[str, Any]
RENDER_MODES = ("rgb_array",)
PICTURE = (480, 640)
"""Height and width of a rendered picture, pixels."""
ROW = np.zeros(1, np.int64)


class RobotEnv(gym.Env[Observed, Float32Array]):
    """One robot with a task; the vector of N such environments does the same to the bit.

    Observation: a dict of the groups in `observe` (see `lirs_envs.episodes.observations.GROUPS`).

    Action: (2,) in [-1, 1]: speed ahead and turn rate, of the robot's largest; of a robot that flies (3,):
    of 3 m/s, 1.5 rad/s and a climb of 1 m/s.

    Reward: that of the task, less 5 a second of contact of the body and 0.1 a second of full action.

    Terminated: by the task, tipped over, left the world, or the simulation diverged (`info["error"]`); why is
    `info["reason"]`. Truncated: the time is up.

    `view` holds what is not observed: true pose, world, goal, and `reading()`, which a mapper takes.
    `reset(options=...)` takes what the task lists in `option_names`.

    Args:
        task: `mapping`, `navigation` or `traverse`.
        kind: of the course, where the task is to cross one.
        render_mode: `rgb_array` or None.
        **options: fields of `EnvConfig`.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012  Gymnasium's contract

    def __init__(
        self, task: str, *, kind: str = MIXED, render_mode: str | None = None, **options: Any
    ) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self.episodes = Episodes(task, make_config(options), 1, kind=kind)
        self.metadata = self.metadata | {"render_fps": round(self.episodes.config.control_hz)}
        self.action_space = self.episodes.action_space
        self.observation_space = self.episodes.observations.space
        self.view = EpisodeView(self.episodes, 0)
        self._renderer: mujoco.Renderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin an episode (see `Episodes.reset`)."""
        super().reset(seed=seed)
        self.episodes.reset(0, self.np_random, options)
        return self._observed(), self._info()

    def step(self, action: Float32Array) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Act for one period (see `Episodes.step`)."""
        episodes = self.episodes
        reward = episodes.step(ROW, np.asarray(action)[None])
        ended = bool(episodes.terminated[0]), bool(episodes.truncated[0])
        return self._observed(), float(reward[0]), *ended, self._info()

    @property
    def difficulty(self) -> float:
        """Of the next episode, 0 to 1; to be set."""
        return self.view.difficulty

    @difficulty.setter
    def difficulty(self, value: float) -> None:
        self.view.difficulty = value

    def render(self) -> ByteArray | None:
        """Return a picture (480, 640, 3) from the chase camera; needs OpenGL (EGL without a screen)."""
        if self.render_mode is None:
            return None
        bodies = self.episodes.simulation.bodies
        if self._renderer is None:
            self._renderer = make_renderer(bodies.models[0])
        return picture_of(self._renderer, bodies.data(0))

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        # A renderer belongs to the environment that made it.
        return self.__dict__ | {"_renderer": None}

    def _observed(self) -> Observed:
        return {name: values[0] for name, values in self.episodes.observations.read(ROW).items()}

    def _info(self) -> dict[str, Any]:
        infos = self.episodes.infos()
        info = {k: v[0].copy() if v.ndim > 1 else v.item(0) for k, v in infos.items()}
        error = self.episodes.simulation.errors[0]
        return info | {"error": error} if error else info


def make_config(options: dict[str, Any]) -> EnvConfig:
    """Return the config of an environment's options.

    Raises:
        ConfigError: an option is unknown, or has a value that is not legal.
    """
    try:
        return EnvConfig(**options)
    except TypeError as error:
        raise ConfigError(f"unknown option of the environment: {error}") from None


def check_render_mode(render_mode: str | None) -> None:
    """Check a render mode.

    Raises:
        ConfigError: there is no such mode.
    """
    if render_mode not in (None, *RENDER_MODES):
        raise ConfigError(f"unknown render mode {render_mode!r}; legal: {', '.join(RENDER_MODES)}, None")


def make_renderer(model: mujoco.MjModel) -> mujoco.Renderer:
    """Return a renderer.

    Raises:
        SimulationError: there is no OpenGL.
    """
    try:
        return mujoco.Renderer(model, *PICTURE)
    except Exception as error:
        # MuJoCo and PyOpenGL raise whatever the platform gives them.
        raise SimulationError(
            "render_mode 'rgb_array' needs OpenGL: a screen, or libegl1 libegl-mesa0 libgl1-mesa-dri "
            f"libopengl0 and lirs_envs imported before mujoco (or MUJOCO_GL=egl): {error}"
        ) from error


def picture_of(renderer: mujoco.Renderer, data: mujoco.MjData) -> ByteArray:
    """Return a picture (480, 640, 3) from the chase camera."""
    view = mujoco.MjvOption()
    view.geomgroup[:] = (1, 1, 1, 1, 0, 1)
    renderer.update_scene(data, camera="chase", scene_option=view)
    picture: ByteArray = renderer.render()
    return picture
