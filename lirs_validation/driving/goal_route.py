"""To a goal over a mapper's own map: straight on known ground, else by the frontier that promises most."""

from __future__ import annotations

import math

import numpy as np

from lirs_validation.driving.frontier_route import FrontierRoute
from lirs_validation.driving.planning.exploration_map import ExplorationMap
from lirs_validation.driving.planning.grid_search import penalize_behind
from lirs_wct.arrays import IntArray
from lirs_wct.geometry.grid_search import Reach, search
from lirs_wct.geometry.pose import Pose2

ARC = 0.6
"""Radius in which the robot turns round where there is room, meters."""


class GoalRoute(FrontierRoute):
    """Plans to a goal where the map shows a way, else to the frontier with the shortest way by it.

    Beyond a frontier the way is taken for the straight line to the goal.

    Attributes:
        goal: x, y in the map frame, meters.
    """

    goal: tuple[float, float] = (0.0, 0.0)
    slack = math.inf

    def _ahead(self, chart: ExplorationMap, pose: Pose2) -> IntArray | None:
        """Return None: there is a goal to set off for."""
        return None

    def _to_frontier(self, chart: ExplorationMap, pose: Pose2, first: IntArray) -> IntArray | None:
        """Return the cells (n, 2) to the goal, else to the best frontier."""
        row, col = chart.grid.cells(self.goal).tolist()
        inside = 0 <= row < chart.known.shape[0] and 0 <= col < chart.known.shape[1]
        if inside and chart.room[row, col] > 0:
            local = pose.yaw - chart.grid.origin.yaw
            weight = penalize_behind(chart.weight, first, local, ARC / chart.grid.resolution)
            reach = search(weight, first[None], chart.grid.resolution)
            if math.isfinite(reach.cost[row, col]):
                return reach.path((row, col))
        return super()._to_frontier(chart, pose, first)

    def _best(self, chart: ExplorationMap, reach: Reach, cells: IntArray, pose: Pose2) -> tuple[int, int]:
        """Return the cell of the frontier with the shortest way to the goal by it."""
        beyond = np.linalg.norm(chart.grid.centers(cells) - np.array(self.goal), axis=1)
        row, col = cells[int(np.argmin(reach.cost[cells[:, 0], cells[:, 1]] + beyond))].tolist()
        return row, col
