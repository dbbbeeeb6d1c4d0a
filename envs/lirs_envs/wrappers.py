"""Wrappers of the environments: curriculum, and a mapper's map as an observation."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorWrapper

from lirs_envs.episodes.observations import Group
from lirs_envs.sensing.sensors import Observation
from lirs_envs.tasks.task import Stage, Task
from lirs_envs.vector_env import split_infos
from lirs_wct import ConfigError, Imu, LaserScan, OccupancyGrid, Pose2
from lirs_wct.arrays import ByteArray, FloatArray, IntArray


class DifficultyPace:
    """Difficulty that follows the recent success rate (see `Curriculum`).

    Attributes:
        difficulty: difficulty of the next episode, 0 to 1.

    Raises:
        ConfigError: a value is not legal.
    """

    def __init__(
        self, difficulty: float, step: float, episodes: int, raise_at: float, lower_at: float
    ) -> None:
        if not (0 <= difficulty <= 1 and 0 < step <= 1 and episodes >= 1 and 0 <= lower_at < raise_at <= 1):
            raise ConfigError(
                "a curriculum needs 0 <= difficulty <= 1, 0 < step <= 1, episodes >= 1 and "
                f"0 <= lower_at < raise_at <= 1, got {difficulty}, {step}, {episodes}, {lower_at}, {raise_at}"
            )
        self.difficulty = difficulty
        self._step, self._limits = step, (lower_at, raise_at)
        self._outcomes: deque[bool] = deque(maxlen=episodes)

    def add(self, success: bool) -> None:
        """Take in the outcome of an episode."""
        self._outcomes.append(success)
        if len(self._outcomes) < (self._outcomes.maxlen or 0):
            return
        share, (low, high) = sum(self._outcomes) / len(self._outcomes), self._limits
        if share >= high:
            self.difficulty = min(1.0, self.difficulty + self._step)
        elif share <= low:
            self.difficulty = max(0.0, self.difficulty - self._step)
        else:
            return
        self._outcomes.clear()


class Curriculum(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Curriculum: raise or lower the difficulty by the recent success rate.

    After each `episodes` episodes at a difficulty: with at least `raise_at` of them successful it goes up by
    `step`, with at most `lower_at` down. `info["difficulty"]` of a reset tells the one of the episode.

    Args:
        env: environment with a `difficulty` and `info["success"]`.
        difficulty: difficulty of the first episode, 0 to 1.
        step: change of the difficulty.
        episodes: number of episodes in the success rate.
        raise_at: least success rate at which the difficulty rises.
        lower_at: largest success rate at which the difficulty falls.

    Raises:
        ConfigError: a value is not legal, or the environment has no difficulty.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        *,
        difficulty: float = 0.0,
        step: float = 0.05,
        episodes: int = 10,
        raise_at: float = 0.8,
        lower_at: float = 0.3,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self, difficulty=difficulty, step=step, episodes=episodes, raise_at=raise_at, lower_at=lower_at
        )
        super().__init__(env)
        if not env.has_wrapper_attr("difficulty"):
            raise ConfigError("a curriculum needs an environment with a difficulty")
        self._pace = DifficultyPace(difficulty, step, episodes, raise_at, lower_at)

    @property
    def difficulty(self) -> float:
        """Difficulty of the next episode, 0 to 1."""
        return self._pace.difficulty

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode at the present difficulty."""
        self.env.set_wrapper_attr("difficulty", self.difficulty)
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, info | {"difficulty": self.difficulty}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and count the outcome of an episode that ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            self._pace.add(bool(info.get("success", False)))
        return observation, reward, terminated, truncated, info


class VectorCurriculum(VectorWrapper):
    """Curriculum of a vector: one difficulty for all robots, by the success rate of all their episodes.

    A new difficulty takes effect in the resets after it.

    Args:
        env: vector of environments with a `difficulty`, wrapped or not.
        difficulty: as all others, see `Curriculum`; an outcome in `episodes` may be any robot's.
        step: change of the difficulty.
        episodes: number of episodes in the success rate.
        raise_at: least success rate at which the difficulty rises.
        lower_at: largest success rate at which the difficulty falls.

    Raises:
        ConfigError: a value is not legal, or the environments have no difficulty.
    """

    def __init__(
        self,
        env: Any,
        *,
        difficulty: float = 0.0,
        step: float = 0.05,
        episodes: int = 10,
        raise_at: float = 0.8,
        lower_at: float = 0.3,
    ) -> None:
        super().__init__(env)
        self._pace = DifficultyPace(difficulty, step, episodes, raise_at, lower_at)
        self._vector = env.unwrapped  # Wrappers have neither `get_attr` nor `set_attr`.
        try:
            self._vector.get_attr("difficulty")
        except AttributeError:
            raise ConfigError("a curriculum needs environments with a difficulty") from None
        self._vector.set_attr("difficulty", difficulty)

    @property
    def difficulty(self) -> float:
        """Difficulty of the next episodes, 0 to 1."""
        return self._pace.difficulty

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step, and count the outcomes of episodes that end."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        over = np.flatnonzero(terminated | truncated).tolist()
        rows = split_infos(infos, self.num_envs) if over else []
        for i in over:
            self._pace.add(bool(rows[i].get("final_info", rows[i]).get("success", False)))
        self._vector.set_attr("difficulty", self.difficulty)
        return observations, rewards, terminated, truncated, infos


UNKNOWN, FREE, OCCUPIED = 0, 127, 255
"""Values of the map's cells."""


class ScanMapper(Protocol):
    """Mapper of the wrapper (see `slam_baselines.mapper.Mapper`)."""

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Return `T_map_base` with a scan added."""

    def map(self) -> OccupancyGrid:
        """Return the map so far."""


class MapObservation(gym.Wrapper[Any, Any, Any, Any]):
    """Adds `map_pose`, (3,) x, y, yaw of `T_map_base`, and `local_map` to a dict of observations.

    `local_map`: (1, cells, cells) uint8, 0 = unknown, 127 = free, 255 = occupied. The mapper's pose is in the
    center, row 0 = ahead, column 0 = left. The mapper receives each new scan once.

    Args:
        env: environment with dict observations; its `view.reading()` gives scan, odometry and attitude.
        make_mapper: returns a new mapper for each episode, such as `lambda: make_mapper("hector")`.
        cells: along a side of the local map.
        cell: edge of its cells, meters.

    Raises:
        ConfigError: the observations are no dict, or a size is not above 0.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        make_mapper: Callable[[], ScanMapper],
        *,
        cells: int = 64,
        cell: float = 0.25,
    ) -> None:
        super().__init__(env)
        if not isinstance(env.observation_space, spaces.Dict):
            raise ConfigError("a map is added to observations that are a dict: wrap before flattening")
        if cells < 1 or not 0 < cell < math.inf:
            raise ConfigError(f"a local map needs cells of a size above 0, got {cells} of {cell} m")
        self.observation_space = spaces.Dict(
            {
                **env.observation_space.spaces,
                "map_pose": spaces.Box(-np.inf, np.inf, (3,), np.float64),
                "local_map": spaces.Box(0, 255, (1, cells, cells), np.uint8),
            }
        )
        self._make_mapper, self._cells, self._cell = make_mapper, cells, cell
        self._pose, self._stamp = Pose2(), -math.inf
        self.mapper: ScanMapper | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode with a new mapper."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.mapper, self._stamp = self._make_mapper(), -math.inf
        return self._with_map(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and update the mapper with a new scan."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._with_map(observation), float(reward), terminated, truncated, info

    def _with_map(self, observation: dict[str, Any]) -> dict[str, Any]:
        assert self.mapper is not None, "reset comes first"
        reading: Observation = self.env.get_wrapper_attr("view").reading()
        if reading.scan.stamp > self._stamp:
            self._pose = self.mapper.update(reading.scan, reading.odometry, reading.imu)
            self._stamp = reading.scan.stamp
        local = local_map(self.mapper.map(), self._pose, self._cells, self._cell)
        return observation | {"map_pose": self._pose.as_array(), "local_map": local}


class MapMemory:
    """Mappers of N robots: each receives a robot's new scans, its odometry and attitude.

    Args:
        stage: the robots.
        make_mapper: returns a new mapper for each episode.
        cells: along a side of the local map.
        cell: edge of its cells, meters.
    """

    def __init__(self, stage: Stage, make_mapper: Callable[[], ScanMapper], cells: int, cell: float) -> None:
        self._stage, self._make_mapper, self._size = stage, make_mapper, (cells, cell)
        self._mappers: list[ScanMapper | None] = [None] * stage.count
        self._poses, self._stamps = [Pose2()] * stage.count, np.full(stage.count, -math.inf)

    def begin(self, i: int) -> None:
        """Give robot `i` a new mapper and its first scan."""
        self._mappers[i], self._stamps[i] = self._make_mapper(), -math.inf
        self._update(i)

    def step(self, ids: IntArray) -> None:
        """Update the mappers of robots with a new scan."""
        for i in ids.tolist():
            self._update(i)

    def _update(self, i: int) -> None:
        mapper, reading = self._mappers[i], self._stage.simulation.reading(i)
        assert mapper is not None, "begin comes first"
        if reading.scan.stamp > self._stamps[i]:
            self._poses[i] = mapper.update(reading.scan, reading.odometry, reading.imu)
            self._stamps[i] = reading.scan.stamp

    def read(self, ids: IntArray) -> ByteArray:
        """Return (n, 1, cells, cells) local maps (see `MapObservation`)."""
        maps = []
        for i in ids.tolist():
            mapper = self._mappers[i]
            assert mapper is not None, "begin comes first"
            maps.append(local_map(mapper.map(), self._poses[i], *self._size))
        return np.array(maps)

    def read_poses(self, ids: IntArray) -> FloatArray:
        """Return (n, 3) x, y, yaw of `T_map_base`, meters and radians."""
        return np.array([self._poses[i].as_array() for i in ids.tolist()])


def map_groups(
    make_mapper: Callable[[], ScanMapper], *, cells: int = 64, cell: float = 0.25
) -> dict[str, Group]:
    """Return groups of observations `local_map` and `map_pose` from one mapper, for vectors too.

    They go into `lirs_envs.episodes.observations.GROUPS`. Map and pose are the mapper's, not the truth (see
    `MapObservation`). Pickled environments need a `make_mapper` that can be pickled.

    Args:
        make_mapper: returns a new mapper for each episode, such as `partial(make_mapper, "hector")`.
        cells: along a side of the local map.
        cell: edge of its cells, meters.

    Raises:
        ConfigError: a size is not above 0.
    """
    if cells < 1 or not 0 < cell < math.inf:
        raise ConfigError(f"a local map needs cells of a size above 0, got {cells} of {cell} m")

    def memory(stage: Stage, task: Task) -> MapMemory:
        return MapMemory(stage, make_mapper, cells, cell)

    return {
        "local_map": Group(lambda stage: spaces.Box(0, 255, (1, cells, cells), np.uint8), memory=memory),
        "map_pose": Group(
            lambda stage: spaces.Box(-np.inf, np.inf, (3,), np.float64),
            memory=memory,
            recall=MapMemory.read_poses,
        ),
    }


def map_group(make_mapper: Callable[[], ScanMapper], *, cells: int = 64, cell: float = 0.25) -> Group:
    """Return the group `local_map` alone, for a name of yours (see `map_groups`)."""
    return map_groups(make_mapper, cells=cells, cell=cell)["local_map"]


def local_map(grid: OccupancyGrid, T_map_base: Pose2, cells: int, cell: float) -> ByteArray:
    """Return the map (1, cells, cells) around a pose. Row 0 = ahead, column 0 = left."""
    offset = ((cells - 1) / 2 - np.arange(cells)) * cell
    ahead, left = np.meshgrid(offset, offset, indexing="ij")
    at = grid.cells(T_map_base.apply(np.stack((ahead, left), axis=-1)))
    inside = np.all((at >= 0) & (at < np.array(grid.shape)), axis=-1)
    held = np.where(inside[..., None], at, 0)
    log_odds = np.where(inside, grid.log_odds[held[..., 0], held[..., 1]], np.nan)
    probability = 1 / (1 + np.exp(-log_odds))
    values = np.where(probability > 0.65, OCCUPIED, np.where(probability < 0.25, FREE, UNKNOWN))
    return values.astype(np.uint8)[None]
