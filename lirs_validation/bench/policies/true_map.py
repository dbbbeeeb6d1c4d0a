"""The upper bound: shortest ways over the true map, followed by the true pose.

To a goal it drives the shortest comfortable way (A* and Dijkstra find the same). To map, it drives to the
unseen ground with the most of its kind around it for the way there: the next best view of Gonzalez-Banos
and Latombe ("Navigation strategies for exploring indoor environments", 2002), who estimate what is unseen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import cv2
import numpy as np

from lirs_envs.env import RobotEnv
from lirs_envs.policies.policy import PolicyContext
from lirs_envs.tasks.site import SEEN_CELL
from lirs_validation.bench.policies.driven import DrivenPolicy
from lirs_validation.driving.choice import MARGIN
from lirs_validation.driving.driver import Driver, Frame
from lirs_validation.driving.pace import driver_config
from lirs_validation.driving.path_driver import DriverConfig, Path, PathDriver
from lirs_validation.driving.planning.clearance import path_weight, room_at, room_in
from lirs_validation.driving.planning.grid_search import area_round, nearest, penalize_behind
from lirs_validation.driving.planning.path_smoothing import smoothed
from lirs_validation.driving.pursuit import speed_profile
from lirs_validation.driving.tour import ground_height
from lirs_validation.driving.waypoint_route import WaypointRoute
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.formats.waypoints import Waypoint
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.grid_search import search
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2

MARGINS = (MARGIN, 0.1, 0.05, 0.0)
"""Meters beyond the robot's radius that a plan keeps: the largest at which a way leads to the goal."""
VIEW = 4.0
"""Unseen ground so far east, west, north and south counts for a place, meters."""
DECAY = 0.15
"""Share by which a place loses worth with each meter of way (lambda of the paper), 1/m."""
ARC = 1.0
"""Radius in which the robot turns round where there is room, meters."""


class OnTrueMap(DrivenPolicy):
    """Drives on the true map by the true pose, which no other policy is given."""

    def __init__(self, env: RobotEnv, context: PolicyContext) -> None:
        super().__init__(context)
        self._env = env

    def pose(self, observation: Mapping[str, Any]) -> Pose2:
        """Return the true pose."""
        return self._env.view.T_world_base.to_pose2()

    def driver(self) -> Driver:
        """Return a driver to the goal, or to what is unseen."""
        view, pace = self._env.view, driver_config(self.context.robot)
        start, surface = view.T_world_base.to_pose2(), view.world.surface
        if view.goal is not None:
            goal = Waypoint(*view.goal)
            route = WaypointRoute((goal,), self._free(start, view.goal), pace, surface)
            return PathDriver(route, start, pace)
        free = self._free(start, None)
        return PathDriver(UnseenRoute(free, start, self._unseen(), pace, surface), start, pace)

    def _free(self, start: Pose2, goal: tuple[float, float] | None) -> OccupancyGrid:
        """Return the grid of the largest margin at which the robot can set off, and reach the goal."""
        robot, world = self.context.robot, self._env.view.world
        for margin in MARGINS:
            free = world.traversable(clearance=robot.radius + margin, max_slope=robot.max_slope)
            ends = free.cells([(start.x, start.y), *([goal] if goal else [])])
            _, areas = cv2.connectedComponents(free.free.astype(np.uint8), connectivity=4)
            held = np.clip(ends, 0, np.array(free.shape) - 1)
            found = set(areas[held[:, 0], held[:, 1]].tolist())
            if len(found) == 1 and found != {0}:
                break
        return free

    def _unseen(self) -> Callable[[], FloatArray]:
        """Return a function that gives (n, 2) the middles of the reachable cells that nobody saw yet."""
        stage = self._env.episodes.stage
        frame, wanted = self._env.episodes.task.ground(0)

        def unseen() -> FloatArray:
            assert stage.seen is not None, "the mapping task has it"
            cells = np.argwhere(wanted & ~stage.seen.seen(0))
            middles: FloatArray = np.array(frame.corner) + (cells[:, ::-1] + 0.5) * SEEN_CELL
            return middles

        return unseen


class UnseenRoute:
    """Leads to where the most unseen ground is for the way, again and again.

    Args:
        free: free cells = where the robot's center may be, world frame.
        start: pose where the robot is set down.
        unseen: returns (n, 2) middles of unseen cells, meters.
        config: how paths are driven.
        surface: the ground, for slower driving where it is steep.
    """

    frame: Frame = "world"
    refresh = 1.0
    ends = ""

    def __init__(
        self,
        free: OccupancyGrid,
        start: Pose2,
        unseen: Callable[[], FloatArray],
        config: DriverConfig,
        surface: HeightField,
    ) -> None:
        self._grid, self._unseen, self._config, self._surface = free, unseen, config, surface
        self._free = area_round(free, start)
        self._room = room_in(self._free, free.resolution)
        self._weight = path_weight(self._free, self._room)
        self._tried = np.zeros_like(self._free)
        self._goal: tuple[int, int] | None = None

    def path(self, pose: Pose2, time: float, undriven: float | None) -> Path | None:
        """Return the path to the best place; None where nothing unseen is left that can be reached."""
        resolution = self._grid.resolution
        first = nearest(self._free, self._grid.cells((pose.x, pose.y)))
        unseen = self._unseen_cells()
        heading = pose.yaw - self._grid.origin.yaw
        weight = penalize_behind(self._weight, first, heading, ARC / resolution)
        reach = search(weight, first[None], resolution)
        # What is not seen from beside it never will be.
        self._tried |= unseen & (reach.cost <= 2 * self._config.step)
        possible = unseen & self._free & ~self._tried & np.isfinite(reach.cost)
        if not possible.any():
            return None
        if self._goal is None or not possible[self._goal]:
            worth = np.where(possible, _around(unseen, resolution) * np.exp(-DECAY * reach.cost), 0.0)
            row, col = divmod(int(np.argmax(worth)), worth.shape[1])
            self._goal = row, col
        cells = self._grid.centers(reach.path(self._goal))
        points = smoothed(cells, self._grid, self._room, keep=self._config.pursuit.careful_room)
        room, height = room_at(self._grid, self._room, points), ground_height(self._surface, points)
        return Path(points, speed_profile(points, room, self._config.pursuit, height))

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Penalize the ground round a place: only the last resort leads there."""
        cells = np.argwhere(self._free)
        near = cells[np.linalg.norm(self._grid.centers(cells) - np.array(point), axis=1) < radius]
        self._weight[near[:, 0], near[:, 1]] += 50.0

    def _unseen_cells(self) -> BoolArray:
        """Return (rows, cols) cells of the plan's grid that hold the middle of an unseen one."""
        unseen = np.zeros(self._free.shape, np.bool_)
        cells = np.clip(self._grid.cells(self._unseen()), 0, np.array(unseen.shape) - 1)
        unseen[cells[:, 0], cells[:, 1]] = True
        return unseen


def _around(unseen: BoolArray, resolution: float) -> FloatArray:
    """Return (rows, cols) the share of unseen cells in the square view around each cell."""
    across = 2 * math.ceil(VIEW / resolution) + 1
    kernel = (across, across)
    share = cv2.boxFilter(unseen.astype(np.float32), -1, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(share, dtype=np.float64)
