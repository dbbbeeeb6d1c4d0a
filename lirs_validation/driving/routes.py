"""Routes over the true ground: an endless tour that covers it, and waypoints.

The tour is greedy, like a person who wants to see everything: go to the nearest place not seen yet, rather
ahead than behind, and now and then back to an old place, which closes loops.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path as File

import cv2
import numpy as np

from lirs_validation.driving.path_driver import DriverConfig, Frame
from lirs_validation.driving.paths import (
    ARC,
    COMFORTABLE,
    STRAIGHT,
    TURN,
    Path,
    PursuitConfig,
    Reach,
    arc_length,
    area_round,
    cells_ahead,
    nearest,
    path_weight,
    penalize_behind,
    room_in,
    search,
    smooth_path,
    speed_profile,
)
from lirs_wct import BoolArray, FloatArray, HeightField, IntArray, OccupancyGrid, Pose2, SourceError
from lirs_wct.formats.drive_files import RoutePoint
from lirs_wct.geometry import wrap_angles
from lirs_wct.navigation import nearest_place


class FreeGround:
    """Free cells that are connected with a start pose, and the cost of driving there.

    Attributes:
        grid: Frame of the cells.
        free: (rows, cols) places where the robot's center may be.
        room: (rows, cols) meters to the nearest blocked cell.
        weight: (rows, cols) cost of a meter in each cell.

    Args:
        grid: Grid whose free cells are places for the robot's center, world frame.
        start: Any pose; only cells reachable from there are free.
        surface: Heights of the ground, for slower driving where it is steep.
    """

    def __init__(self, grid: OccupancyGrid, start: Pose2, surface: HeightField | None) -> None:
        self.grid, self._surface = grid, surface
        self.free = area_round(grid, start)
        self.room = room_in(self.free, grid.resolution)
        self.weight = path_weight(self.free, self.room)

    def nearest(self, x: float, y: float) -> IntArray:
        """Return (2,) row and column of the free cell nearest to a point."""
        return nearest(self.free, self.grid.cells((x, y)))

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Penalize cells round a point in the grid's frame: only the last resort leads there."""
        cells = np.argwhere(self.free)
        near = cells[np.linalg.norm(self.grid.centers(cells) - np.array(point), axis=1) < radius]
        self.weight[near[:, 0], near[:, 1]] += 50.0

    def smooth(self, points: FloatArray, keep: float, *, hold: int = 0) -> FloatArray:
        """Smooth a path of points (n, 2); see `smooth_path`."""
        return smooth_path(points, self.grid, self.room, keep=keep, hold=hold)

    def path(self, points: FloatArray, config: PursuitConfig, yaw: float | None = None) -> Path:
        """Return a path through points (n, 2) with speeds for the clearance and the slope."""
        height = None
        if self._surface is not None:
            height = np.nan_to_num(self._surface.height_at(points[:, 0], points[:, 1]))
        return Path(points, speed_profile(points, self.grid, self.room, config, height), yaw)


RADIUS = 4.0
"""Distance within which a tour covers free ground, meters; at most a fifth of the free ground's side."""
LOOP = 50.0
"""Meters of tour between two returns to an old place."""


class TourRoute:
    """Tours that cover the ground (see `FreeGround`) for a time, each cell within `radius` meters."""

    frame: Frame = "world"
    refresh = math.inf
    ends = "the tour is over"

    def __init__(
        self,
        free: OccupancyGrid,
        start: Pose2,
        rng: np.random.Generator,
        seconds: float,
        config: DriverConfig,
        surface: HeightField | None = None,
    ) -> None:
        self._grid, self._rng = free, rng
        self._seconds, self._config = seconds, config
        self.ground = FreeGround(free, start, surface)
        self._free, self.avoid = self.ground.free, self.ground.avoid
        # In a small place as large a radius would cover all from anywhere, and the robot would only turn.
        side = math.sqrt(float(self._free.sum())) * free.resolution
        self.radius = min(RADIUS, max(0.8, 0.2 * side))
        self._plain = np.where(self._free, 1.0, np.inf)
        self._covered_at = np.full(free.shape, -np.inf)
        self._driven: FloatArray = np.array([[start.x, start.y]])
        self._length = 0.0
        self._next_loop = LOOP

    def path(self, pose: Pose2, time: float, undriven: float | None) -> Path:
        """Plan a tour long enough for the rest of the time at full speed."""
        if undriven is not None:
            # Its last meters, planned but not driven, are no part of the tour.
            arc = arc_length(self._driven)
            self._length = max(0.0, self._length - undriven)
            self._driven = self._driven[arc <= max(arc[-1] - undriven, 0.0)]
            self._covered_at[self._covered_at > self._length] = -np.inf
        # Smoothing shortens the tour, and planning again in the middle of a run would cost a tick.
        length = 10.0 + 1.3 * max(0.0, self._seconds - time) * self._config.pursuit.speed
        # From rest straight ahead: turning wheels slip most while a mapper knows least.
        points = self.tour(pose, length, straight=STRAIGHT if time == 0.0 else 0.0)
        return self.ground.path(points, self._config.pursuit)

    @property
    def coverage(self) -> float:
        """Share of the reachable cells that the tours so far pass."""
        return float((self._covered_at[self._free] > -np.inf).mean())

    def tour(self, start: Pose2, length: float, *, straight: float = 0.0) -> FloatArray:
        """Return points (n, 2), 0.1 m apart, of a free path from a pose.

        It begins at the nearest free cell, and is `length` meters long before smoothing; the first `straight`
        meters lead ahead.
        """
        ahead = cells_ahead(self._grid, self._free, start, straight)
        cell, heading = ahead[-1], start.yaw
        legs, planned = [self._grid.centers(ahead)], 0.0
        self._cover(ahead)
        while planned < length:
            leg = self._leg(cell, heading)
            if len(leg) < 2:
                break
            points = self._grid.centers(leg)
            legs.append(points[1:])
            step = float(arc_length(points)[-1])
            planned += step
            self._length += step
            self._driven = np.concatenate((self._driven, points[1:]))
            self._cover(leg)
            cell = leg[-1]
            tail = points[-1] - points[max(0, len(points) - 8)]
            heading = math.atan2(tail[1], tail[0])
        points = np.concatenate(legs)
        return self.ground.smooth(points, COMFORTABLE / 2, hold=len(ahead) - 1)

    def _leg(self, cell: IntArray, heading: float) -> IntArray:
        """Return cells (n, 2) from here to the next goal."""
        goals = self._goals(cell)
        if not goals.any():
            return cell[None]
        slack = TURN + self.radius
        # Turning in place grinds all wheels sideways, and on a slope the robot slides down meanwhile.
        arc, local = ARC / self._grid.resolution, heading - self._grid.origin.yaw
        weight = penalize_behind(self.ground.weight, cell, local, arc)
        reach = search(weight, cell[None], self._grid.resolution, goals=goals, slack=slack)
        return reach.path(self._choice(reach, goals, cell, heading))

    def _goals(self, cell: IntArray) -> BoolArray:
        """Mark the next goals: uncovered cells, or an old place if a loop is due.

        When all is covered, the fifth that was covered longest ago.
        """
        other = self._free.copy()
        other[cell[0], cell[1]] = False
        if self._length >= self._next_loop:
            self._next_loop = self._length + LOOP * self._rng.uniform(0.7, 1.3)
            # A few random places of the tour's first half.
            early = self._driven[: max(1, len(self._driven) // 2)]
            cells = self._grid.cells(early[self._rng.integers(len(early), size=8)])
            row, col = np.clip(cells, 0, np.array(self._free.shape) - 1).T
            old = np.zeros(self._free.shape, np.bool_)
            old[row, col] = other[row, col]
            if old.any():
                return old
        # Where there is room to turn round first: a dead end is mostly covered from its mouth.
        roomy: BoolArray = other & (self.ground.room >= COMFORTABLE)
        for candidates in (roomy, other):
            never: BoolArray = candidates & (self._covered_at == -np.inf)
            if never.any():
                return never
        candidates = roomy if roomy.any() else other
        if not candidates.any():
            return candidates
        oldest: BoolArray = candidates & (self._covered_at <= np.quantile(self._covered_at[candidates], 0.2))
        return oldest

    def _choice(self, reach: Reach, goals: BoolArray, cell: IntArray, heading: float) -> tuple[int, int]:
        """Choose among reached goals: near, ahead, and a little by chance."""
        reached = np.argwhere(goals & np.isfinite(reach.cost))
        if len(reached) > 300:
            reached = reached[self._rng.choice(len(reached), 300, replace=False)]
        offset = self._grid.centers(reached) - self._grid.centers(cell)
        turn = np.abs(wrap_angles(np.arctan2(offset[:, 1], offset[:, 0]) - heading))
        row, col = reached.T
        cost = reach.cost[row, col] + TURN * turn / math.pi
        # A goal at the rim of the covered area has little gain: prefer one step into uncovered ground. A gain
        # is 0 to 2 radii, by the share of uncovered ground around.
        side = 2 * max(1, round(self.radius / self._grid.resolution)) + 1
        new = (self._free & (self._covered_at == -np.inf)).astype(np.float32)
        share = cv2.boxFilter(new, -1, (side, side), borderType=cv2.BORDER_CONSTANT)
        gain = 2 * self.radius * share[row, col].astype(np.float64)
        best = int(np.argmin(cost - gain + self._rng.uniform(0, 0.5, len(reached))))
        return int(row[best]), int(col[best])

    def _cover(self, path: IntArray) -> None:
        """Mark the cells covered from a path: within the radius, not through walls."""
        near = search(self._plain, path, self._grid.resolution, limit=self.radius)
        self._covered_at[np.isfinite(near.cost)] = self._length


class WaypointRoute:
    """Route through waypoints on the ground (see `FreeGround`).

    A path ends at the last one, and at each with a wanted yaw.
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
        self.avoid = self._ground.avoid
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
    """Check that a robot can stand at every waypoint, and drive to each."""
    reached = free
    for number, waypoint in enumerate(waypoints, start=1):
        place = waypoint.x, waypoint.y
        row, col = free.cells(place).tolist()
        if not (0 <= row < free.shape[0] and 0 <= col < free.shape[1]):
            corners = free.centers([(-0.5, -0.5), (free.shape[0] - 0.5, free.shape[1] - 0.5)])
            (west, south), (east, north) = corners.tolist()
            problem = f" is off the map, which is x {west:g} to {east:g}, y {south:g} to {north:g} m"
        elif not free.free[row, col]:
            problem = f" is no place for {robot}: {cause(place)}"
        elif not reached.free[row, col]:
            problem = f": no way leads there from the first waypoint for {robot}"
        else:
            if number == 1:
                area = area_round(free, Pose2(*place))
                reached = OccupancyGrid.from_mask(~area, free.resolution, free.origin)
            continue
        nearest = nearest_place(reached, place)
        hint = "" if nearest is None else f"; nearest place: {nearest}"
        raise SourceError(f"{path}: waypoint {number} ({place[0]:g}, {place[1]:g}){problem}{hint}")
