"""N environments as one: `gym.make_vec(id, num_envs=N, vectorization_mode="vector_entry_point")`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from lirs_envs.env import LimitedEpisodes, Observed, make_config, snapshot_of
from lirs_envs.episodes.episodes import Episodes, EpisodeView, action_array, check_options
from lirs_envs.rendering import RENDER_MODES, Views, check_render_mode
from lirs_wct import BoolArray, ConfigError, FloatArray, IntArray, Pose2, unknown_name
from lirs_wct.errors import within

Stepped = tuple[Observed, FloatArray, BoolArray, BoolArray, dict[str, Any]]


class JoinedEpisodes:
    """Episodes in several worlds as one; rows are numbered world by world.

    Attributes:
        parts: Episodes of each world.
        places: Part and row in it of each row.
        config: Options of the first part; those of others differ in the world.
    """

    def __init__(self, parts: Sequence[Episodes]) -> None:
        self.parts, self.config, self.max_steps = tuple(parts), parts[0].config, parts[0].max_steps
        self.places = [(part, k) for part in parts for k in range(part.count)]
        self.action_space, self.observation_space = parts[0].action_space, parts[0].observations.space
        self._ends = np.cumsum([part.count for part in parts])

    def reset(self, i: int, rng: np.random.Generator, options: dict[str, Any]) -> None:
        """Begin an episode of robot `i` (see `Episodes.reset`)."""
        part, k = self.places[i]
        part.reset(k, rng, options)

    def step(self, ids: IntArray, actions: FloatArray) -> FloatArray:
        """Apply actions for one period; return the rewards (n,) (see `Episodes.step`)."""
        cuts = np.searchsorted(ids, self._ends)[:-1]
        shares = zip(self._split(ids), np.split(actions, cuts), strict=True)
        return np.concatenate([part.step(rows, taken) for (part, rows), taken in shares if len(rows)])

    def read(self, ids: IntArray) -> Observed:
        """Return new (n, ...) arrays of the observation groups."""
        groups = [part.observations.read(rows) for part, rows in self._split(ids) if len(rows)]
        return {name: np.concatenate([one[name] for one in groups]) for name in groups[0]}

    def _split(self, ids: IntArray) -> list[tuple[Episodes, IntArray]]:
        """Return sorted rows (n,) as each part's own rows."""
        shares = np.split(ids, np.searchsorted(ids, self._ends)[:-1])
        ends = zip(self.parts, shares, self._ends.tolist(), strict=True)
        return [(part, rows - (end - part.count)) for part, rows, end in ends]

    @property
    def terminated(self) -> BoolArray:
        """(N,) see `Episodes`."""
        return np.concatenate([part.terminated for part in self.parts])

    @property
    def truncated(self) -> BoolArray:
        """(N,) see `Episodes`."""
        return np.concatenate([part.truncated for part in self.parts])

    @property
    def errors(self) -> list[str]:
        """Reason why each robot's simulation cannot continue; empty = it can."""
        return [error for part in self.parts for error in part.simulation.errors]

    def infos(self) -> dict[str, Any]:
        """Return (N, ...) arrays of the entries of `info`."""
        infos = [part.infos() for part in self.parts]
        return {name: np.concatenate([one[name] for one in infos]) for name in infos[0]}


class RobotVectorEnv(LimitedEpisodes, VectorEnv[Observed, FloatArray, Any]):
    """N robots in separate environments, bit-equal to N times `RobotEnv` at any thread count.

    A reset with seed s seeds environment i with s + i, as Gymnasium's vectors do. `call`, `get_attr` and
    `set_attr` reach the attributes of each `EpisodeView`, such as `difficulty`.

    Args:
        num_envs: number of robots, N.
        task: `mapping`, `navigation` or `traverse`.
        kind: kind of course, for the traverse task only; None = `mixed`.
        autoreset_mode: `NextStep`, `SameStep` or `Disabled` (see Gymnasium's `AutoresetMode`).
        threads: number of threads; None = all processors of this process.
        max_episode_steps: number of steps until an episode is truncated, in place of the task's time limit;
            None = that one. A `time_limit` holds as well.
        render_mode: `rgb_array`, `depth_array`, `map` (see `lirs_envs.rendering`) or None.
        **options: fields of `EnvConfig`. `world` may be a list of W worlds: environment i of N is in world
            i * W // N.
    """

    metadata = {  # noqa: RUF012  Gymnasium's contract
        "render_modes": [mode for mode in RENDER_MODES if mode != "human"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        task: str,
        *,
        kind: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        _check_counts(num_envs=num_envs, threads=threads, max_episode_steps=max_episode_steps)
        modes = [mode.value for mode in AutoresetMode]
        if autoreset_mode not in (*AutoresetMode, *modes):
            raise unknown_name("autoreset_mode", str(autoreset_mode), modes)
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.num_envs, self.render_mode = num_envs, render_mode
        threads = len(os.sched_getaffinity(0)) if threads is None else threads
        self.episodes: JoinedEpisodes = JoinedEpisodes(
            [
                Episodes(
                    task,
                    make_config(options | one, "autoreset_mode", "max_episode_steps", "num_envs", "threads"),
                    count,
                    threads=min(threads, count),
                    kind=kind,
                    max_steps=max_episode_steps,
                )
                for one, count in _divide(options, num_envs)
            ]
        )
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        fps = round(self.episodes.config.control_hz)
        self.metadata = self.metadata | {"render_fps": fps, "autoreset_mode": self.autoreset_mode}
        self.single_action_space = self.episodes.action_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.single_observation_space = self.episodes.observation_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.views = tuple(EpisodeView(part, k) for part, k in self.episodes.places)
        self._rngs: list[np.random.Generator | None] = [None] * num_envs
        self._all = np.arange(num_envs)
        self._over: BoolArray = np.zeros(num_envs, np.bool_)
        self._pictures = [Views() for _ in range(num_envs)]
        self._paths: list[list[Pose2]] = [[] for _ in range(num_envs)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin episodes: of all, or of those in `options["reset_mask"]`.

        Raises:
            ConfigError: the number of seeds is not N, the mask is no mask, or an option is not legal.
            SimulationError: see `Episodes.reset`.
        """
        rest, ids = dict(check_options(options)), self._all
        if "reset_mask" in rest:
            mask = rest.pop("reset_mask")
            legal = isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == self._all.shape
            if not legal or not mask.any():
                raise ConfigError(
                    f"reset_mask must be a bool array ({self.num_envs},) with a True, got {mask!r}"
                )
            ids = np.flatnonzero(mask)
        seeds = [int(seed) + i for i in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise ConfigError(f"{self.num_envs} environments need as many seeds, got {len(seeds)}")
        for i, one in enumerate(() if seeds is None else seeds):
            if one is not None and i in ids:
                self._rngs[i], _ = seeding.np_random(one)
        self._reset(ids, rest)
        return self._observe(), self._infos(ids)

    def step(self, actions: Any) -> Stepped:
        """Act for one period in all environments.

        The autoreset mode decides about episodes that end.

        Raises:
            ConfigError: the actions have a wrong shape, or one is not finite.
            SimulationError: an environment was not reset, or with autoreset disabled has ended.
        """
        episodes = self.episodes
        actions = action_array(actions, self.action_space.shape or ())
        rewards = np.zeros(self.num_envs)
        waiting = self._over if self.autoreset_mode is AutoresetMode.NEXT_STEP else np.zeros_like(self._over)
        ids = np.flatnonzero(~waiting)
        if waiting.any():
            self._reset(np.flatnonzero(waiting), {})
        if len(ids):
            rewards[ids] = episodes.step(ids, actions[ids])
        ended = episodes.terminated.copy(), episodes.truncated.copy()
        self._over = ended[0] | ended[1]
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            return self._reset_at_once(rewards, ended)
        return self._observe(), rewards, *ended, self._infos(self._all)

    def _reset_at_once(self, rewards: FloatArray, ended: tuple[BoolArray, BoolArray]) -> Stepped:
        over = self._over.copy()
        ids = np.flatnonzero(over)
        final_info, last = self._infos(ids), self.episodes.read(ids)
        final = np.full(self.num_envs, None, dtype=object)
        for k, i in enumerate(ids.tolist()):
            final[i] = {name: values[k].copy() for name, values in last.items()}
        self._reset(ids, {})
        infos = {"final_obs": final, "_final_obs": over, "final_info": final_info, "_final_info": over.copy()}
        return self._observe(), rewards, *ended, infos | self._infos(self._all)

    def _reset(self, ids: IntArray, options: dict[str, Any]) -> None:
        for i in ids.tolist():
            rng = self._rngs[i]
            if rng is None:
                rng, _ = seeding.np_random()
                self._rngs[i] = rng
            self.episodes.reset(i, rng, options)
            self._paths[i].clear()
        self._over[ids] = False

    def render(self) -> tuple[Any, ...] | None:
        """Return the picture of each environment (see `RobotEnv.render`)."""
        if self.render_mode is None:
            return None
        alike, shown = len({id(view.world) for view in self.views}) == 1, []
        for i, view in enumerate(self.views):
            snapshot, path = snapshot_of(*self.episodes.places[i]), self._paths[i]
            path.append(snapshot.T_world_base.to_pose2())
            # Environments in the same world share one scene.
            views = self._pictures[0 if alike else i]
            shown.append(views.render(self.render_mode, snapshot, path=path, scan=view.reading().scan))
        return tuple(shown)

    def close_extras(self, **_: Any) -> None:
        """Release OpenGL resources and threads."""
        for views in self._pictures:
            views.close()
        for part in self.episodes.parts:
            part.simulation.close()

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of each environment's view, or return its attribute."""
        values = [getattr(view, name) for view in self.views]
        return tuple(value(*args, **kwargs) if callable(value) else value for value in values)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of each environment's view."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of each view, to one value or one per environment.

        Raises:
            ConfigError: the number of values is not N.
            AttributeError: there is no such attribute.
        """
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ConfigError(f"set_attr needs {self.num_envs} values of {name!r}, got {len(each)}")
        for view, value in zip(self.views, each, strict=True):
            setattr(view, name, value)

    def _observe(self) -> Observed:
        return self.episodes.read(self._all)

    def _infos(self, ids: IntArray) -> dict[str, Any]:
        """Return the infos of some environments, each with its mask of environments."""
        mask = np.zeros(self.num_envs, np.bool_)
        mask[ids] = True
        infos: dict[str, Any] = {}
        for name, values in self.episodes.infos().items():
            if len(ids) < self.num_envs:
                values[~mask] = None if values.dtype == object else 0
            infos[name], infos[f"_{name}"] = values, mask.copy()
        errors = self.episodes.errors
        for i in [i for i in ids.tolist() if errors[i]]:
            infos = self._add_info(infos, {"error": errors[i]}, i)
        return infos


def split_infos(infos: Any, count: int) -> list[dict[str, Any]]:
    """Return a vector's infos as one dict per environment, with its own keys."""
    if isinstance(infos, list):
        return infos  # A wrapper has split them.
    rows: list[dict[str, Any]] = [{} for _ in range(count)]
    for name, values in infos.items():
        mask = infos.get(f"_{name}")
        if mask is None:
            continue
        parts = split_infos(values, count) if isinstance(values, dict) else values
        for i in np.flatnonzero(mask).tolist():
            rows[i][name] = parts[i]
    return rows


def _divide(options: dict[str, Any], count: int) -> list[tuple[dict[str, Any], int]]:
    """Return the option `world` of each part, and its number of environments."""
    worlds = options.get("world")
    if not isinstance(worlds, list | tuple):
        return [({}, count)]
    if not 1 <= len(worlds) <= count:
        raise ConfigError(f"world must be 1 to num_envs = {count} worlds, got {len(worlds)}")
    first = [-(-k * count // len(worlds)) for k in range(len(worlds) + 1)]
    return [({"world": world}, first[k + 1] - first[k]) for k, world in enumerate(worlds)]


def _check_counts(**counts: Any) -> None:
    """Check that counts are whole numbers from 1 up; None is legal except for `num_envs`."""
    for name, count in counts.items():
        if count is not None or name == "num_envs":
            within("[1, inf)", whole=True)(count, name)
