"""Navigation: reach a goal on drivable ground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from lirs_envs.tasks.site import Site, distance_at
from lirs_envs.tasks.task import GoalTask, Stage, point
from lirs_wct import Pose2, SimulationError
from lirs_wct.arrays import FloatArray, IntArray

NEAR, FAR = 3.0, 30.0
"""Longest path to a goal at difficulty 0 and 1, meters."""
CANDIDATES = 8
"""Goals among which the difficulty picks one by the roughness of the straight line to it."""


class NavigationTask(GoalTask):
    """Navigation task: reward per meter gained on the shortest path to the goal.

    Goal and collision end the episode.

    The way is the shortest over ground that the robot can drive. The goal is reached where way and straight
    distance are at most 0.5 m, or the robot's radius if that is more, and no obstacle is between. Difficulty
    sets how long the way is, and how rough and how much blocked the straight line to the goal is.
    """

    observe: ClassVar = ("scan", "goal", "attitude")
    time_limit: ClassVar = 90.0
    option_names: ClassVar = ("start", "goal", "difficulty")
    ends_at_contact: ClassVar = True

    def __init__(self, stage: Stage) -> None:
        super().__init__(stage)
        self._radius = max(0.5, stage.simulation.config.robot.radius)
        robot, grid = stage.simulation.config.robot, stage.site.grid
        self._open = stage.site.world.traversable(
            clearance=0.0, max_slope=robot.max_slope, resolution=grid.resolution
        ).free
        self._costs: list[FloatArray] = [np.zeros((0, 0))] * stage.count
        self._ways = np.zeros((stage.count, 2))
        """Way to the goal at the start, and now."""
        self._collision = np.zeros(stage.count, np.bool_)

    def draw(self, i: int, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2 | None:
        """Draw start and goal (see `Task.draw`)."""
        site, start = self.stage.site, self.stage.start(rng, options)
        if "goal" in options:
            x, y = point(options["goal"], 2, "goal")
        else:
            found = draw_goal(site, start, float(self.stage.difficulty[i]), rng)
            if found is None:
                return None
            x, y = found
        cost = site.distances(x, y) if site.area(x, y) else np.full(site.areas.shape, np.inf)
        way = _way(site, cost, start.x, start.y)
        if not math.isfinite(way):
            if "goal" in options:
                raise SimulationError(
                    f"no way leads from ({start.x:.2f}, {start.y:.2f}) to the goal ({x:.2f}, {y:.2f})"
                )
            return None
        self.goals[i], self._costs[i], self._ways[i] = (x, y), cost, way
        return start

    def begin(self, i: int) -> None:
        """Begin with neither success nor collision."""
        self.success[i] = self._collision[i] = False

    def step(self, ids: IntArray) -> FloatArray:
        """Return the meters gained, plus the rewards of success and collision."""
        simulation, weights = self.stage.simulation, self.stage.rewards
        places = simulation.T_world_base[ids, :2].tolist()
        ways = np.array(
            [_way(self.stage.site, self._costs[i], *place) for i, place in zip(ids, places, strict=True)]
        )
        # Off the drivable ground the robot gains nothing until it returns.
        present = np.where(np.isfinite(ways), ways, self._ways[ids, 1])
        gained = self._ways[ids, 1] - present
        self._ways[ids, 1] = present
        # Within the radius, but not through an obstacle.
        near = np.maximum(self.distances()[ids], ways) <= self._radius
        self.success[ids] = [near[k] and self._sees_goal(i) for k, i in enumerate(ids)]
        self._collision[ids] = simulation.touched[ids] & ~self.success[ids]
        rewards: FloatArray = gained + (
            weights.success * self.success[ids] + weights.collision * self._collision[ids]
        )
        return rewards

    def end(self, i: int) -> str:
        """Return "success" or "collision"."""
        return "success" if self.success[i] else "collision" if self._collision[i] else ""

    def infos(self) -> dict[str, Any]:
        """Return outcome, goal, straight distance to it and the shortest way from the start, meters."""
        return {
            "success": self.success.copy(),
            "collision": self._collision.copy(),
            "goal": self.goals.copy(),
            "distance": self.distances(),
            "shortest_path": self._ways[:, 0].copy(),
        }

    def _sees_goal(self, i: int) -> bool:
        """Return whether the straight line to the goal is free of obstacles.

        A short path may lead around a wall.
        """
        place, share = self.stage.simulation.T_world_base[i, :2], np.linspace(0.0, 1.0, 32)[:, None]
        cells = self.stage.site.grid.cells((1 - share) * place + share * self.goals[i])
        row, col = np.clip(cells, 0, np.array(self._open.shape) - 1).T
        return bool(self._open[row, col].all())


def _way(site: Site, cost: FloatArray, x: float, y: float) -> float:
    """Return the shortest way from a point to the goal of a cost grid, meters."""
    origin = site.grid.origin
    way: float = distance_at(cost, (origin.x, origin.y), site.grid.resolution, x, y)
    return way


def draw_goal(
    site: Site, start: Pose2, difficulty: float, rng: np.random.Generator
) -> tuple[float, float] | None:
    """Return a goal whose distance and roughness follow the difficulty; None = none found."""
    if not site.area(start.x, start.y):
        return None
    longest = NEAR + difficulty * (FAR - NEAR)
    # Two cells of margin: only the end of the area shortens the longest path.
    ways = site.distances(start.x, start.y, longest + 2 * site.grid.resolution)
    longest = min(longest, float(ways[np.isfinite(ways)].max()))
    cells = np.argwhere((ways >= max(0.6 * longest, 1.5)) & (ways <= longest))
    if len(cells) == 0:
        return None
    goals = site.grid.centers(cells[rng.integers(len(cells), size=CANDIDATES)])
    roughness = [_roughness(site, start, goal) for goal in goals]
    chosen = np.argsort(roughness, kind="stable")[round(difficulty * (CANDIDATES - 1))]
    x, y = goals[chosen].tolist()
    return x, y


def _roughness(site: Site, start: Pose2, goal: FloatArray) -> float:
    """Return the mean roughness of a straight line to the goal.

    A sample counts 1 where the robot cannot stand, else the slope in radians.
    """
    share = np.linspace(0.0, 1.0, 64)[:, None]
    cells = site.grid.cells((1 - share) * np.array((start.x, start.y)) + share * goal)
    cells = np.clip(cells, 0, np.array(site.areas.shape) - 1)
    row, col = cells[:, 0], cells[:, 1]
    return float(np.where(site.areas[row, col] > 0, site.slope[row, col], 1.0).mean())
