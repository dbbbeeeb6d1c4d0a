"""Drawing of tasks: starts and goals with room for a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lirs_envs.env import RobotEnv
from lirs_envs.tasks.site import SEEN_CELL
from lirs_extensions.bench.episode import reset_options
from lirs_extensions.bench.policies import MARGINS
from lirs_extensions.bench.tasks import BenchTask, TaskSet, WorldSpec
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import Scenario, build_scenario
from lirs_wct import (
    BuildOptions,
    ConfigError,
    FloatArray,
    Progress,
    SimulationError,
    SourceError,
    World,
    no_progress,
)

VERSION = 1
"""Version of the drawing in a user's worlds."""
DIFFICULTIES = (0.5, 0.75, 1.0)
"""Difficulties of goals, in turn."""
DRAWS, STRIDE = 200, 10_000
"""Draws for a task at its difficulty, and as many at the least; distance of their seeds."""
PACE = 0.8
"""Speed from which time limits are made, m/s, or 0.8 x the robot's where that is less."""
CONNECTED = 0.5
"""Least share of the robot's ground that its ways connect."""
BLOCKED = 6.0
"""Meters within which the way straight ahead of a start to map from is blocked."""
NEAR_START = 0.4
"""Least angle between heading and goal, radians: straight ahead is no way to a goal."""


@dataclass(frozen=True, kw_only=True)
class OwnWorld(WorldSpec):
    """World of a user's source, known by the SHA-256 of each of its files."""

    source: str
    build: BuildOptions
    content: tuple[str, ...]

    def world(self, data: Path | None) -> World:
        """Build the world, or return it from memory."""
        return _scenario(self.source, self.build).world

    def describe(self) -> dict[str, Any]:
        """Return what decides the world, as JSON."""
        usual = vars(BuildOptions())
        build = {name: str(value) for name, value in vars(self.build).items() if value != usual[name]}
        return {"maker": self.maker, "name": self.name, "sha256": [*self.content], "build": build}


@lru_cache(maxsize=4)
def _scenario(source: str, build: BuildOptions) -> Scenario:
    return build_scenario(RunConfig(source=source, build=build))


def find_worlds(sources: Sequence[str], build: BuildOptions) -> list[OwnWorld]:
    """Build worlds of sources, each with a name of its own; of a terrain over 200 m, a window of 50 m."""
    _scenario.cache_clear()  # files may have changed
    worlds: dict[str, OwnWorld] = {}
    for source in sources:
        found = _scenario(source, build)
        content, name = tuple(file["sha256"] for file in found.files), found.world.name
        if name in worlds:
            raise SourceError(f"{source}: its world is named {name}, as that of {worlds[name].source}")
        worlds[name] = OwnWorld(name=name, maker="source", source=source, build=build, content=content)
    return [*worlds.values()]


def draw_set(
    worlds: Sequence[OwnWorld], task: str, robot: str, count: int, seed: int, progress: Progress = no_progress
) -> TaskSet:
    """Draw tasks in each world; the same seed draws the same tasks."""
    tasks: list[BenchTask] = []
    for place in worlds:
        try:
            drawing = TaskDrawing(place, place.world(None), task, robot)
            for k in range(count):
                progress(f"drawing for {place.name}", len(tasks) / (count * len(worlds)))
                name = f"{place.name}-{robot}-seed{seed}-{k}"
                tasks.append(drawing.draw(name, 2 * DRAWS * STRIDE * seed + k, k))
        except (SimulationError, ConfigError) as error:
            raise SourceError(
                f"{place.source}: {error}; try another --robot, --window, --size, --height or --resolution"
            ) from error
    return TaskSet(name=task, version=VERSION, tasks=tuple(tasks))


class TaskDrawing:
    """Tasks of one kind for a robot in a world.

    Start and goal are connected with the largest margin that leaves half of the ground connected.

    Args:
        margins: Distances from obstacles beyond the robot's radius to choose from, meters, the largest first.
    """

    def __init__(
        self,
        place: WorldSpec,
        world: World,
        task: str,
        robot: str,
        *,
        split: str = "test",
        margins: Sequence[float] = MARGINS,
    ) -> None:
        self._place, self._task, self._split = place, task, split
        self._env = RobotEnv(task, world=world, robot=robot)
        site, self._robot = self._env.episodes.stage.site, self._env.episodes.stage.simulation.robot
        whole = np.count_nonzero(site.areas == site.largest) * site.grid.resolution**2
        for margin in margins:
            clearance = self._robot.radius + margin
            grid = world.traversable(clearance=clearance, max_slope=self._robot.max_slope)
            _, areas = cv2.connectedComponents(grid.free.astype(np.uint8), connectivity=4)
            if np.bincount(areas.ravel())[1:].max(initial=0) * grid.resolution**2 >= CONNECTED * whole:
                break
        self._roomy = replace(site, grid=grid, areas=areas)

    def draw(self, name: str, seed: int, k: int) -> BenchTask:
        """Draw task `k` as the environment draws episodes.

        A start, and a goal if there is one, have room around them and a way between them. The goal is 10 to
        30 m away, or as far as the world allows; where that finds none, 2 to 3 m.
        """
        env = self._env
        for number in range(2 * DRAWS):
            env.difficulty = DIFFICULTIES[k % len(DIFFICULTIES)] if number < DRAWS else 0.0
            observation, info = env.reset(seed=seed + STRIDE * number)
            x, y, yaw = _rounded(info["T_world_base"])
            start = (x, y, yaw)
            more = self._to_goal(start, observation, info) if "goal" in info else self._to_map(start)
            if more is None:
                continue
            task = BenchTask(
                name=name,
                task=self._task,
                split=self._split,
                robot=self._robot.name,
                seed=seed,
                world=self._place,
                start=start,
                **more,
            )
            with suppress(SimulationError):  # start and goal were rounded
                env.reset(seed=seed, options=reset_options(task))
                return task
        ends = "start and goal" if self._task == "navigation" else "start with an obstacle ahead"
        wide, steep = 2 * self._robot.radius, math.degrees(self._robot.max_slope)
        raise SimulationError(
            f"no {ends} in {2 * DRAWS} draws for a {self._robot.name}: "
            f"{wide:.1f} m wide, slopes up to {steep:.0f} degrees"
        )

    def _to_goal(
        self, start: tuple[float, float, float], observation: Mapping[str, Any], info: Mapping[str, Any]
    ) -> dict[str, Any] | None:
        """Return goal and time limit; None = no room, or the goal is straight ahead."""
        goal = _rounded(info["goal"])
        from_area, to_area = self._roomy.area(*start[:2]), self._roomy.area(*goal)
        if not 0 < from_area == to_area or abs(observation["goal"][1]) < NEAR_START:
            return None
        return {"goal": goal, "time_limit": self._time_limit(20, 4 * info["shortest_path"])}

    def _to_map(self, start: tuple[float, float, float]) -> dict[str, Any] | None:
        """Return path budget and time limit; None = no room, or nothing stands straight ahead."""
        x, y, yaw = start
        ahead = np.arange(0.0, BLOCKED + 0.05, 0.1)[:, None] * (math.cos(yaw), math.sin(yaw))
        areas = [self._roomy.area(*point) for point in np.add(ahead, (x, y)).tolist()]
        if not areas[0] or all(areas):
            return None
        site = self._env.episodes.stage.site
        reachable = float(site.reachable(site.area(x, y)).sum()) * SEEN_CELL**2
        budget = max(5.0, 5.0 * round(2.5 * math.sqrt(reachable) / 5))
        return {"path_budget": budget, "time_limit": self._time_limit(30, 2 * budget)}

    def _time_limit(self, seconds: int, meters: float) -> float:
        """Return seconds, and those in which the robot drives some meters."""
        return float(math.ceil(seconds + meters / min(PACE, 0.8 * self._robot.max_speed)))


def _rounded(values: FloatArray) -> tuple[float, ...]:
    """Return numbers with three digits."""
    return tuple(round(float(value), 3) for value in values)
