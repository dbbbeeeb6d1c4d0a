"""Frontier-based exploration (Yamauchi, CIRA 1997) on the mapper's own map, by the mapper's own pose.

The explorer drives to the nearest place where the known free ground borders the unknown, again and again.
It is given neither the world nor the true pose: where the mapper is wrong, so is the drive.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from lirs_validation.driving.path_driver import DriverConfig, Frame
from lirs_validation.driving.paths import (
    ARC,
    STRAIGHT,
    TURN,
    Path,
    Reach,
    cells_ahead,
    nearest,
    path_weight,
    penalize_behind,
    room_in,
    search,
    smooth_path,
    speed_profile,
)
from lirs_wct.geometry import OCCUPIED, BoolArray, FloatArray, IntArray, OccupancyGrid, Pose2, njit

RESOLUTION = 0.1
"""Meters a cell, at least: finer maps are thinned out."""
UNSURE = 20.0
"""Cost factor of a meter where part of the robot would be over unknown ground."""
MOST_CELLS = 1_000_000
"""Cells, at most: the time for a plan is bounded, however large the map grows."""


@dataclass(frozen=True)
class ExplorationMap:
    """A mapper's map as an explorer plans on it, map frame.

    Attributes:
        grid: resolution and origin; free = where the robot's center may be with all of it on known ground.
        known: (rows, cols) seen and not occupied.
        frontier: (rows, cols) known cells beside unknown ones, in groups that the robot fits through.
        room: (rows, cols) meters from free cells to the nearest other; 0 in these.
        weight: (rows, cols) cost of a meter; inf where the center may not be at all.
    """

    grid: OccupancyGrid
    known: BoolArray
    frontier: BoolArray
    room: FloatArray
    weight: FloatArray

    @property
    def passable(self) -> BoolArray:
        """(rows, cols) where the robot's center may be, if need be partly over unknown ground."""
        return np.isfinite(self.weight)

    def goals(self, frontier: BoolArray, reach: float) -> BoolArray:
        """Mark the free cells within a distance of some frontier cells, meters."""
        near = _distance_to(frontier, self.grid.resolution) <= reach
        mask: BoolArray = near & (self.room > 0)
        return mask


def exploration_map(
    mapped: OccupancyGrid, stood: FloatArray, blocked: FloatArray, *, footprint: float, clearance: float
) -> ExplorationMap:
    """Prepare a mapper's map for planning.

    Args:
        mapped: Map of the mapper.
        stood: (n, 2) places where the robot was: its footprint there is free, whatever its lidar missed.
        blocked: (m, 3) x, y and radius of places where it did not get on.
        footprint: Radius of the robot, which never leaves the known ground, meters.
        clearance: Distance that its center keeps from occupied cells, meters.
    """
    occupied, known, origin, resolution = _thin_out(mapped, margin=clearance + RESOLUTION)
    frame = OccupancyGrid(np.zeros(known.shape, np.float32), resolution, origin)
    known |= _discs(frame, np.column_stack((stood, np.full(len(stood), footprint))))
    known &= ~occupied
    unknown = _without_holes(~known & ~occupied, math.pi * footprint**2 / resolution**2)
    known = ~unknown & ~occupied
    to_occupied, to_unknown = _distance_to(occupied, resolution), _distance_to(unknown, resolution)
    possible = known & (to_occupied > clearance) & ~_discs(frame, blocked)
    free = possible & (to_unknown > footprint)
    edge = known & (to_unknown <= 1.5 * resolution) & (to_occupied > 2 * resolution)
    room = room_in(free, resolution)
    # At the start, and between rays, the robot stands partly on unknown ground: it must get out of there.
    weight = np.where(possible & ~free, UNSURE, path_weight(free, room))
    grid = OccupancyGrid.from_mask(~free, resolution, origin)
    return ExplorationMap(grid, known, _without_small(edge, 2 * footprint / resolution), room, weight)


def distance_in_sight(chart: ExplorationMap, pose: Pose2, cells: IntArray) -> FloatArray:
    """Return (n,) distances to visible cells (n, 2) ahead of a pose, meters.

    A cell is visible if only known cells lie between; inf for others.
    """
    offset = chart.grid.centers(cells) - (pose.x, pose.y)
    ahead = offset @ np.array((math.cos(pose.yaw), math.sin(pose.yaw))) >= 0
    ahead[ahead] = _in_sight(chart.known, chart.grid.cells((pose.x, pose.y)), cells[ahead])
    return np.where(ahead, np.hypot(offset[:, 0], offset[:, 1]), np.inf)


def _thin_out(mapped: OccupancyGrid, margin: float) -> tuple[BoolArray, BoolArray, Pose2, float]:
    """Return occupied and known cells with unknown ones all round, their origin and resolution.

    A cell is occupied where any part of it is, else known where any part is.
    """
    factor = max(1, round(RESOLUTION / mapped.resolution))
    while mapped.log_odds.size > factor**2 * MOST_CELLS:
        factor *= 2
    rows, cols = (factor * math.ceil(n / factor) for n in mapped.shape)
    padded = np.full((rows, cols), np.nan, np.float32)
    padded[: mapped.shape[0], : mapped.shape[1]] = mapped.log_odds
    largest = padded[::factor, ::factor]
    for row, col in itertools.product(range(factor), repeat=2):
        largest = np.fmax(largest, padded[row::factor, col::factor])
    resolution = factor * mapped.resolution
    edge = math.ceil(margin / resolution) + 1
    occupied = np.pad(largest > math.log(OCCUPIED / (1 - OCCUPIED)), edge)
    known = np.pad(~np.isnan(largest), edge)
    return occupied, known, mapped.origin @ Pose2(-edge * resolution, -edge * resolution), resolution


def _distance_to(mask: BoolArray, resolution: float) -> FloatArray:
    """Return (rows, cols) meters to the nearest marked cell; inf where none is."""
    if not mask.any():
        return np.full(mask.shape, np.inf)
    cells = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    distance: FloatArray = cells.astype(np.float64) * resolution
    return distance


def _discs(grid: OccupancyGrid, discs: FloatArray) -> BoolArray:
    """Mark the cells inside discs (n, 3): x, y, radius in meters."""
    mask = np.zeros(grid.shape, np.uint8)
    for (row, col), radius in zip(grid.cells(discs[:, :2]).tolist(), discs[:, 2].tolist(), strict=True):
        cv2.circle(mask, (col, row), round(radius / grid.resolution), 1, -1)
    return mask.astype(np.bool_)


def _without_holes(unknown: BoolArray, cells: float) -> BoolArray:
    """Return unknown cells without groups so small that no robot is lost in them."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(unknown.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] > cells
    large[0] = False
    kept: BoolArray = large[labels]
    return kept


def _without_small(frontier: BoolArray, cells: float) -> BoolArray:
    """Return frontier cells in groups at least so many cells across."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(frontier.astype(np.uint8), connectivity=8)
    across = np.maximum(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    long = across >= cells
    long[0] = False
    kept: BoolArray = long[labels]
    return kept


@njit
def _in_sight(known: BoolArray, eye: IntArray, cells: IntArray) -> BoolArray:
    """Whether the straight line to each cell passes known cells alone."""
    seen = np.ones(len(cells), np.bool_)
    for k in range(len(cells)):
        dr, dc = cells[k, 0] - eye[0], cells[k, 1] - eye[1]
        steps = max(abs(dr), abs(dc))
        for s in range(1, steps):
            if not known[eye[0] + round(s * dr / steps), eye[1] + round(s * dc / steps)]:
                seen[k] = False
                break
    return seen


REACH = 0.3
"""Meters beyond the footprint from which a frontier counts as reached."""
NEAR_DISTANCE, FAR_DISTANCE, LOOKS = 8.0, 16.0, 3.0
"""A frontier that was in sight from so near (meters) in so many plans, and is still one, stays unknown; looks
from farther away count by the square of the distance, beyond the second one not at all."""
PLACE = 0.2
"""Side of the squares whose looks are counted, meters."""
LOYAL = 1.0
"""A frontier so near to the one chosen before is the same one, meters: it is kept until it is seen."""
NEIGHBORHOOD = 1.5
"""Distance within which a place counts as visited, meters."""


class FrontierRoute:
    """Route to the nearest frontier, or else to the place visited longest ago."""

    frame: Frame = "map"
    refresh = 1.0
    ends = ""
    slack = TURN
    """Meters beyond the way to the nearest frontier up to which others are looked at."""

    def __init__(
        self,
        mapper_map: Callable[[], OccupancyGrid],
        footprint: float,
        clearance: float,
        config: DriverConfig,
    ) -> None:
        self._map, self._config = mapper_map, config
        self._footprint, self._clearance = footprint, clearance
        self._stood: list[tuple[float, float]] = []
        self._blocked: list[tuple[float, float, float]] = []
        self._looks: dict[int, float] = {}
        self._goal: FloatArray | None = None

    def path(self, pose: Pose2, time: float, undriven: float | None) -> Path | None:
        """Return the path on the present map; None where the map shows no way."""
        self._stood.append((pose.x, pose.y))
        chart = exploration_map(
            self._map(),
            np.array(self._stood),
            np.array(self._blocked).reshape(-1, 3),
            footprint=self._footprint,
            clearance=self._clearance,
        )
        if not chart.passable.any():
            return None
        first = nearest(chart.passable, chart.grid.cells((pose.x, pose.y)))
        cells = self._ahead(chart, pose)
        if cells is None:
            cells = self._to_frontier(chart, pose, first)
        if cells is None:
            cells = self._to_old_place(chart, first)
        if cells is None or len(cells) < 2:
            return None
        self._goal = chart.grid.centers(cells[-1])
        keep = self._config.pursuit.careful_room
        points = smooth_path(chart.grid.centers(cells), chart.grid, chart.room, keep=keep)
        return Path(points, speed_profile(points, chart.grid, chart.room, self._config.pursuit))

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Block a place where the robot did not get on, map frame."""
        self._blocked.append((*point, radius))

    def _ahead(self, chart: ExplorationMap, pose: Pose2) -> IntArray | None:
        """Return the free cells (n, 2) straight ahead at the start of a drive.

        Turning wheels slip most while a mapper knows least.
        """
        left = STRAIGHT - math.dist(self._stood[0], self._stood[-1])
        if left <= 0:
            return None
        ahead = cells_ahead(chart.grid, chart.passable, pose, left)
        return ahead if len(ahead) * chart.grid.resolution > self._config.step else None

    def _to_frontier(self, chart: ExplorationMap, pose: Pose2, first: IntArray) -> IntArray | None:
        """Return the cells (n, 2) to the best frontier; None where none can be reached."""
        goals = chart.goals(self._unseen(chart, pose), self._footprint + REACH)
        # A path shorter than a step ends as it begins: the robot would stand and replan at every scan.
        rows, cols = np.ogrid[: goals.shape[0], : goals.shape[1]]
        goals &= np.hypot(rows - first[0], cols - first[1]) * chart.grid.resolution > 2 * self._config.step
        if not goals.any():
            return None
        local = pose.yaw - chart.grid.origin.yaw
        weight = penalize_behind(chart.weight, first, local, ARC / chart.grid.resolution)
        reach = search(weight, first[None], chart.grid.resolution, goals=goals, slack=self.slack)
        found = np.argwhere(goals & np.isfinite(reach.cost))
        return reach.path(self._best(chart, reach, found, pose)) if len(found) else None

    def _unseen(self, chart: ExplorationMap, pose: Pose2) -> BoolArray:
        """Return the frontier without cells looked at often enough; count the present look."""
        frontier = chart.frontier.copy()
        cells = np.argwhere(frontier)
        places = np.floor(chart.grid.centers(cells) / PLACE).astype(np.int64) @ (1, 1 << 32)
        distance = distance_in_sight(chart, pose, cells)
        looks = (NEAR_DISTANCE / np.maximum(distance, NEAR_DISTANCE)) ** 2
        looked = distance <= FAR_DISTANCE
        for place, look in dict(zip(places[looked].tolist(), looks[looked].tolist(), strict=True)).items():
            self._looks[place] = self._looks.get(place, 0.0) + look
        spent = [place for place, looked in self._looks.items() if looked >= LOOKS]
        frontier[tuple(cells[np.isin(places, spent)].T)] = False
        return frontier

    def _best(self, chart: ExplorationMap, reach: Reach, cells: IntArray, pose: Pose2) -> tuple[int, int]:
        """Return the frontier cell chosen before, else the nearest, preferring cells ahead."""
        points = chart.grid.centers(cells)
        bearing = np.arctan2(points[:, 1] - pose.y, points[:, 0] - pose.x) - pose.yaw
        cost = reach.cost[cells[:, 0], cells[:, 1]] + TURN * np.abs(np.angle(np.exp(1j * bearing))) / math.pi
        if self._goal is not None:
            same = np.linalg.norm(points - self._goal, axis=1) < LOYAL
            cost = np.where(same, cost, np.inf) if same.any() else cost
        row, col = cells[int(np.argmin(cost))].tolist()
        return row, col

    def _to_old_place(self, chart: ExplorationMap, first: IntArray) -> IntArray | None:
        """Return the cells (n, 2) to the nearest place left longest ago; None without one."""
        left = np.full(chart.known.shape, -1, np.int32)  # number of the last visit nearby
        for k, (row, col) in enumerate(chart.grid.cells(self._stood).tolist()):
            cv2.circle(left, (col, row), round(NEIGHBORHOOD / chart.grid.resolution), k, -1)
        reach = search(chart.weight, first[None], chart.grid.resolution)
        cells = np.argwhere((chart.room > 0) & (reach.cost > self._config.step) & np.isfinite(reach.cost))
        if not len(cells):
            return None
        at = tuple(cells.T)
        row, col = cells[np.lexsort((reach.cost[at], left[at]))[0]].tolist()
        return reach.path((row, col))


def warm_up_explorer() -> None:
    """Compile the kernels of an explorer: plan straight ahead, and to a frontier."""
    seen = np.full((120, 120), np.nan, np.float32)
    seen[20:100, 20:100] = -5.0
    route = FrontierRoute(lambda: OccupancyGrid(seen, 0.1), 0.2, 0.3, DriverConfig())
    for x in (3.0, 3.0 + STRAIGHT):
        route.path(Pose2(x, 6.0), 0.0, None)
