"""Wrappers of the environments: curriculum, and a mapper's map as an observation."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorWrapper

from lirs_envs.episodes.observations import Group
from lirs_envs.tasks.task import Stage, Task
from lirs_envs.vector_env import split_infos
from lirs_wct import ByteArray, ConfigError, FloatArray, Imu, IntArray, LaserScan, OccupancyGrid, Pose2


class Curriculum(VectorWrapper):
    """Curriculum of a vector: one difficulty for all robots, by the success rate of all their episodes.

    After each `episodes` episodes at a difficulty: with at least `raise_at` of them successful it goes up by
    `step`, with at most `lower_at` down. A new difficulty takes effect in the resets after it.

    Attributes:
        difficulty: difficulty of the next episodes, 0 to 1.

    Args:
        env: vector of environments with a `difficulty` and `info["success"]`, wrapped or not; of one as well.
        difficulty: difficulty of the first episodes, 0 to 1.
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
        if not (0 <= difficulty <= 1 and 0 < step <= 1 and episodes >= 1 and 0 <= lower_at < raise_at <= 1):
            raise ConfigError(
                "a curriculum needs 0 <= difficulty <= 1, 0 < step <= 1, episodes >= 1 and "
                f"0 <= lower_at < raise_at <= 1, got {difficulty}, {step}, {episodes}, {lower_at}, {raise_at}"
            )
        super().__init__(env)
        self.difficulty = difficulty
        self._step, self._episodes, self._limits = step, episodes, (lower_at, raise_at)
        self._outcomes: list[bool] = []
        self._vector = env.unwrapped  # Wrappers have neither `get_attr` nor `set_attr`.
        try:
            self._vector.get_attr("difficulty")
        except AttributeError:
            raise ConfigError("a curriculum needs environments with a difficulty") from None
        self._vector.set_attr("difficulty", difficulty)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step, and adapt the difficulty to the outcomes of episodes that end."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        over = np.flatnonzero(terminated | truncated).tolist()
        rows = split_infos(infos, self.num_envs) if over else []
        for i in over:
            success = bool(rows[i].get("final_info", rows[i]).get("success", False))
            self._outcomes = [*self._outcomes, success][-self._episodes :]
            share, (low, high) = sum(self._outcomes) / self._episodes, self._limits
            if len(self._outcomes) == self._episodes and not low < share < high:
                change = self._step if share >= high else -self._step
                self.difficulty = min(max(self.difficulty + change, 0.0), 1.0)
                self._outcomes = []
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


class MapMemory:
    """Mappers of N robots: each receives a robot's new scans, its odometry and attitude.

    Args:
        make_mapper: returns a new mapper for each episode.
        cells: along a side of the local map.
        cell: edge of its cells, meters.
    """

    def __init__(self, stage: Stage, make_mapper: Callable[[], ScanMapper], cells: int, cell: float) -> None:
        self._stage, self._make_mapper, self._size = stage, make_mapper, (cells, cell)
        self._mappers: dict[int, ScanMapper] = {}
        self._poses, self._stamps = [Pose2()] * stage.count, np.full(stage.count, -math.inf)

    def begin(self, i: int) -> None:
        """Give robot `i` a new mapper and its first scan."""
        self._mappers[i], self._stamps[i] = self._make_mapper(), -math.inf
        self.step(np.array((i,)))

    def step(self, ids: IntArray) -> None:
        """Update the mappers of robots with a new scan."""
        for i in ids.tolist():
            reading = self._stage.simulation.reading(i)
            if reading.scan.stamp > self._stamps[i]:
                self._poses[i] = self._mappers[i].update(reading.scan, reading.odometry, reading.imu)
                self._stamps[i] = reading.scan.stamp

    def read(self, ids: IntArray) -> ByteArray:
        """Return (n, 1, cells, cells) local maps (see `map_groups`)."""
        maps = [local_map(self._mappers[i].map(), self._poses[i], *self._size) for i in ids.tolist()]
        return np.array(maps)

    def read_poses(self, ids: IntArray) -> FloatArray:
        """Return (n, 3) x, y, yaw of `T_map_base`, meters and radians."""
        return np.array([self._poses[i].as_array() for i in ids.tolist()])


def map_groups(
    make_mapper: Callable[[], ScanMapper], *, cells: int = 64, cell: float = 0.25
) -> dict[str, Group]:
    """Return groups of observations `local_map` and `map_pose` from one mapper.

    They go into `lirs_envs.episodes.observations.GROUPS`. `map_pose`: (3,) x, y, yaw of the mapper's
    `T_map_base`, not of the truth. `local_map`: (1, cells, cells) uint8, 0 = unknown, 127 = free, 255 =
    occupied. The mapper's pose is in the center, row 0 = ahead, column 0 = left. The mapper receives each new
    scan once. Pickled environments need a `make_mapper` that can be pickled.

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
