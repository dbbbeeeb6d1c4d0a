"""Waypoint route: the best free path from each waypoint to the next."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path as File

import numpy as np

from lirs_validation.driving.driver import Frame
from lirs_validation.driving.free_ground import FreeGround
from lirs_validation.driving.path_driver import DriverConfig, Path
from lirs_validation.driving.paths import arc_length, area_round
from lirs_wct import HeightField, OccupancyGrid, Pose2, SourceError
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.formats.waypoints import RoutePoint
from lirs_wct.geometry.grid_search import search
from lirs_wct.navigation import nearest_place


class WaypointRoute:
    """Route through waypoints.

    A path ends at the last one, and at each with a wanted yaw.

    Args:
        waypoints: still to come, world frame.
        free: free cells = where the robot's center may be, world frame.
        config: how paths are driven.
        surface: the ground, for slower driving where it is steep.
    """

    frame: Frame = "world"
    refresh = math.inf
    ends = "the last waypoint is reached"

    def __init__(
        self,
        waypoints: tuple[RoutePoint, ...],
        free: OccupancyGrid,
        config: DriverConfig,
        surface: HeightField | None,
    ) -> None:
        self._left = list(waypoints)
        self._config = config
        self._ground = FreeGround(free, Pose2(waypoints[0].x, waypoints[0].y), surface)
        self._ends_at: list[float] = []
        """Meters of the present path after which each of its waypoints is reached."""
        self._length = 0.0

    def path(self, pose: Pose2, time: float, undriven: float | None) -> Path | None:
        """Return the path to the next waypoints, without those that the path before came by."""
        if undriven is not None:
            driven = self._length - undriven + self._config.step
            self._left = self._left[sum(end <= driven for end in self._ends_at) :]
        if not self._left:
            return None
        legs: list[FloatArray] = [np.array([[pose.x, pose.y]])]
        self._ends_at = []
        for waypoint in self._left:
            leg = self._leg(legs[-1][-1], waypoint)
            legs.append(leg[1:] if len(leg) > 1 else leg)
            self._ends_at.append(float(arc_length(np.concatenate(legs))[-1]))
            if waypoint.yaw is not None:
                break
        points = np.concatenate(legs)[1:]
        self._length = self._ends_at[-1]
        return self._ground.path(points, self._config.pursuit, waypoint.yaw)

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Penalize the ground round a place: only the last resort leads there."""
        self._ground.avoid(point, radius)

    def _leg(self, start: FloatArray, waypoint: RoutePoint) -> FloatArray:
        """Return (n, 2) points from the free cell nearest to a point to a waypoint."""
        ground, grid = self._ground, self._ground.grid
        first, goal = ground.nearest(start[0], start[1]), ground.nearest(waypoint.x, waypoint.y)
        goals = np.zeros_like(ground.free)
        goals[goal[0], goal[1]] = True
        reach = search(ground.weight, first[None], grid.resolution, goals=goals)
        points = grid.centers(reach.path((int(goal[0]), int(goal[1]))))
        points[-1] = waypoint.x, waypoint.y
        return ground.smooth(points, self._config.pursuit.careful_room)


def check_waypoints(
    path: File,
    waypoints: tuple[RoutePoint, ...],
    free: OccupancyGrid,
    robot: str,
    cause: Callable[[tuple[float, float]], str],
) -> None:
    """Check that a robot can stand at every waypoint, and drive to each.

    Raises:
        SourceError: a waypoint is off the map, where the robot cannot be, or cut off from the first.
    """
    cells = free.cells([(w.x, w.y) for w in waypoints])
    inside = np.all((cells >= 0) & (cells < np.array(free.shape)), axis=1)
    area = None
    for number, (waypoint, cell, within) in enumerate(zip(waypoints, cells, inside, strict=True), start=1):
        named = f"{path}: waypoint {number} ({waypoint.x:g}, {waypoint.y:g})"
        if not within:
            raise SourceError(
                f"{named} is off the map, which is {_extent(free)}{_nearest(free, area, waypoint)}"
            )
        if not free.free[cell[0], cell[1]]:
            raise SourceError(
                f"{named} is no place for {robot}: {cause((waypoint.x, waypoint.y))}"
                f"{_nearest(free, area, waypoint)}"
            )
        if area is None:
            area = area_round(free, Pose2(waypoint.x, waypoint.y))
        if not area[cell[0], cell[1]]:
            raise SourceError(
                f"{named}: no way leads there from the first waypoint for {robot}"
                f"{_nearest(free, area, waypoint)}"
            )


def _nearest(free: OccupancyGrid, area: BoolArray | None, waypoint: RoutePoint) -> str:
    """Return a hint for an error: the nearest free and reachable place."""
    reached = free if area is None else OccupancyGrid.from_mask(~area, free.resolution, free.origin)
    place = nearest_place(reached, (waypoint.x, waypoint.y))
    return "" if place is None else f"; nearest place: {place}"


def _extent(grid: OccupancyGrid) -> str:
    """Return the extent of a grid that lies along the axes, in words."""
    (west, south), (east, north) = grid.centers(
        [(-0.5, -0.5), (grid.shape[0] - 0.5, grid.shape[1] - 0.5)]
    ).tolist()
    return f"x {west:g} to {east:g}, y {south:g} to {north:g} m"
