"""Mapping: see the reachable ground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from lirs_envs.tasks.site import SEEN_CELL, SeenFrame
from lirs_envs.tasks.task import Stage, Task
from lirs_wct import ConfigError, Pose2, Pose3, SimulationError
from lirs_wct.arrays import BoolArray, FloatArray, IntArray

STANDING = 0.02
"""Shares of the robot's largest speed and turn rate below which it stands; on slopes it creeps by less."""
COVERED = 0.95
"""Share of the reachable ground at which a world counts as mapped."""


class MappingTask(Task):
    """Mapping task: reward per square meter of ground newly seen in motion.

    A robot that stands earns nothing by the noise of its lidar.

    The episode ends at 95 % of the reachable ground.
    """

    observe: ClassVar = ("scan", "odometry", "attitude")
    time_limit: ClassVar = 120.0
    option_names: ClassVar = ("start",)
    needs_seen: ClassVar = True

    def __init__(self, stage: Stage) -> None:
        super().__init__(stage)
        if stage.seen is None:
            raise ConfigError("the mapping task needs the seen ground")
        self._seen = stage.seen
        self._area = [0] * stage.count
        self._reachable = np.ones(stage.count, np.int64)
        self._before = np.zeros(stage.count, np.int64)
        self._poses = [Pose3()] * stage.count

    def draw(self, i: int, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2 | None:
        """Draw a start (see `Task.draw`)."""
        start = self.stage.start(rng, options)
        self._area[i] = self.stage.site.area(start.x, start.y)
        if not self._area[i]:
            if "start" in options or not self.stage.randomize_start:
                raise SimulationError(f"the start ({start.x:.2f}, {start.y:.2f}) is not on free ground")
            return None
        return start

    def ground(self, i: int) -> tuple[SeenFrame, BoolArray]:
        """Return the whole ground; wanted is its reachable part."""
        site = self.stage.site
        return site.seen, site.reachable(self._area[i])

    def begin(self, i: int) -> None:
        """Begin after the first scan, whose ground earns nothing."""
        self._reachable[i] = max(int(self.ground(i)[1].sum()), 1)
        self._before[i], self._poses[i] = self._seen.cells[i], self.stage.simulation.pose(i)

    def step(self, ids: IntArray) -> FloatArray:
        """Return the square meters newly seen; 0 for robots that stand."""
        cells = self._seen.cells[ids]
        new = np.asarray((cells - self._before[ids]) * SEEN_CELL**2, np.float64)
        self._before[ids] = cells
        return np.where([self._has_moved(i) for i in ids.tolist()], new, 0.0)

    def _has_moved(self, i: int) -> bool:
        """Return whether robot `i` has moved since the last step."""
        before, T = self._poses[i], self.stage.simulation.pose(i)
        self._poses[i] = T
        way, turn = math.dist(T.position, before.position), math.remainder(T.yaw - before.yaw, math.tau)
        robot, share = self.stage.simulation.config.robot, STANDING * self.stage.simulation.period
        return way > share * robot.max_speed or abs(turn) > share * robot.max_turn_rate

    def end(self, i: int) -> str:
        """Return "covered" at 95 %."""
        return "covered" if self._seen.wanted_cells[i] / self._reachable[i] >= COVERED else ""

    def infos(self) -> dict[str, Any]:
        """Return the coverage of the reachable ground, 0 to 1, and the seen area, m^2."""
        coverage = self._seen.wanted_cells / self._reachable
        return {"coverage": coverage, "seen_area": self._seen.cells * SEEN_CELL**2}
