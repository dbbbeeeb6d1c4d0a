"""Usable ground of a world: free areas of a robot, and ground to see."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from lirs_envs.robots.robot import Robot
from lirs_wct import HeightField, OccupancyGrid, Pose2, SimulationError, World
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, Int32Array, njit

SEEN_CELL = 0.25
"""Edge of a cell of the ground that is to be seen, meters."""
PATHS = (3.0, 30.0)
"""Longest path to a goal at difficulty 0 and 1, meters."""
CANDIDATES = 8
"""Number of goals among which the difficulty picks one by the roughness of the straight line to it."""


@dataclass(frozen=True)
class SeenFrame:
    """The grid of the ground that is to be seen.

    Attributes:
        corner: Position x, y of the outer corner of cell (0, 0), row 0 = south; meters.
        height: (rows, cols) float32 height of the ground in each cell's middle, meters; -inf = none there.
    """

    corner: tuple[float, float]
    height: Float32Array


def seen_frame(world: World) -> SeenFrame:
    """Return the grid over a world's ground without walls, holes and missing nodes."""
    surface: HeightField = world.surface
    west, south, east, north = surface.bounds
    rows, cols = math.ceil((north - south) / SEEN_CELL), math.ceil((east - west) / SEEN_CELL)
    x = np.minimum(west + (np.arange(cols) + 0.5) * SEEN_CELL, east)[None, :]
    y = np.minimum(south + (np.arange(rows) + 0.5) * SEEN_CELL, north)[:, None]
    height = surface.height_at(x, y).astype(np.float32)
    if world.walls is not None:
        # Known free floor of a laser map.
        walls, truth, points = world.walls, world.truth, np.stack(np.broadcast_arrays(x, y), axis=-1)
        free, resolution, origin = walls.floor, walls.resolution, walls.origin
        if truth is not None:
            free, resolution, origin = truth.free, truth.resolution, truth.origin
        cells = np.floor(origin.inverse().apply(points)[..., ::-1] / resolution).astype(int)
        inside = np.all((cells >= 0) & (cells < free.shape), axis=-1)
        held = np.where(inside[..., None], cells, 0)
        height[~(inside & free[held[..., 0], held[..., 1]])] = -np.inf
    if world.no_ground is not None:
        row = np.clip(np.rint((north - y) / surface.cell[1]).astype(int), 0, surface.shape[0] - 1)
        col = np.clip(np.rint((x - west) / surface.cell[0]).astype(int), 0, surface.shape[1] - 1)
        height[world.no_ground[row, col]] = -np.inf
    return SeenFrame((west, south), height)


@dataclass(frozen=True)
class Site:
    """Free ground of a robot in a world.

    Attributes:
        grid: Grid whose free cells are where the robot's middle may be.
        areas: (rows, cols) number of the connected area of each free cell, from 1; 0 = not free.
        largest: Number of the largest area.
        seen: Ground that is to be seen.
        slope: (rows, cols) slope of the ground in each cell of `grid`, radians.
    """

    world: World
    grid: OccupancyGrid
    areas: Int32Array
    largest: int
    seen: SeenFrame
    slope: Float32Array

    def __deepcopy__(self, memo: dict[int, Any]) -> Site:
        """Return the site itself: it is a value."""
        return self

    def area(self, x: float, y: float) -> int:
        """Return the number of the area at a point; 0 = not free."""
        row, col = self.grid.cells((x, y)).tolist()
        inside = 0 <= row < self.areas.shape[0] and 0 <= col < self.areas.shape[1]
        return int(self.areas[row, col]) if inside else 0

    def draw_start(self, rng: np.random.Generator) -> Pose2:
        """Return a pose anywhere in the largest area, facing anywhere."""
        cells = np.flatnonzero(self.areas == self.largest)
        row, col = divmod(int(cells[rng.integers(len(cells))]), self.areas.shape[1])
        dx, dy, turn = rng.random(3).tolist()
        x, y = self.grid.origin.apply(
            ((col + dx) * self.grid.resolution, (row + dy) * self.grid.resolution)
        ).tolist()
        return Pose2(x, y, math.pi * (2 * turn - 1))

    def distances(self, x: float, y: float, limit: float = math.inf) -> FloatArray:
        """Return (rows, cols) shortest path lengths to a point, meters; inf = none up to the limit."""
        row, col = self.grid.cells((x, y)).tolist()
        resolution = self.grid.resolution
        cost: FloatArray = _path_lengths(self.areas > 0, row, col, limit / resolution)
        cost *= resolution
        return cost

    def way(self, cost: FloatArray, x: float, y: float) -> float:
        """Return the shortest way, meters, from a point to the goal of `distances`."""
        origin = self.grid.origin
        way: float = _distance_at(cost, (origin.x, origin.y), self.grid.resolution, x, y)
        return way

    def reachable(self, area: int) -> BoolArray:
        """Return (rows, cols) cells of `seen` that the robot's center can reach in an area."""
        rows, cols = self.seen.height.shape
        x = self.seen.corner[0] + (np.arange(cols) + 0.5) * SEEN_CELL
        y = self.seen.corner[1] + (np.arange(rows) + 0.5) * SEEN_CELL
        cells = self.grid.cells(np.stack(np.meshgrid(x, y), axis=-1))
        held = np.clip(cells, 0, np.array(self.areas.shape) - 1)
        there: BoolArray = (self.areas[held[..., 0], held[..., 1]] == area) & np.isfinite(self.seen.height)
        return there


def make_site(world: World, robot: Robot) -> Site:
    """Look at a world with a robot's radius and slopes."""
    resolution = 0.2 if robot.radius >= 0.25 else 0.1
    grid = world.traversable(clearance=robot.radius, max_slope=robot.max_slope, resolution=resolution)
    count, areas = cv2.connectedComponents(grid.free.astype(np.uint8), connectivity=4)
    if count < 2:
        raise SimulationError(f"world {world.name!r} has no free place where {robot.name} could start")
    driven = world.driven(grid).free
    sizes = np.bincount(areas[driven] if driven.any() else areas.ravel())
    surface = world.surface
    steps = np.arange(areas.shape[1]) + 0.5, np.arange(areas.shape[0]) + 0.5
    west, south = surface.origin
    x = np.minimum(west + steps[0] * resolution, surface.bounds[2])[None, :]
    y = np.minimum(south + steps[1] * resolution, surface.bounds[3])[:, None]
    dy, dx = np.gradient(surface.height_at(x, y), resolution)
    slope = np.arctan(np.hypot(dx, dy)).astype(np.float32)
    return Site(world, grid, areas.astype(np.int32), 1 + int(np.argmax(sizes[1:])), seen_frame(world), slope)


@njit
def _path_lengths(free: BoolArray, row: int, col: int, limit: float) -> FloatArray:
    """Return (rows, cols) shortest path lengths to a cell in cells, inf where beyond the limit.

    Paths lead to the eight neighbors and cut no blocked corners (Dijkstra 1959). No step is shorter than a
    cell, so that buckets of one cell's length replace the heap (Dial 1969): a fifth of the time.
    """
    rows, cols = free.shape
    cost = np.full((rows, cols), np.inf)
    bucket, count = np.empty((3, 8 * rows * cols), np.int32), np.zeros(3, np.int64)
    if free[row, col]:
        cost[row, col], bucket[0, 0], count[0] = 0.0, row * cols + col, 1
    length = 0
    while count.any() and length <= limit:
        now = length % 3
        for k in range(count[now]):
            r, c = bucket[now, k] // cols, bucket[now, k] % cols
            here = cost[r, c]
            # A cell whose cost has fallen since is in an earlier bucket, too.
            if here < length:
                continue
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, cols)):
                    if not (free[i, j] and free[r, j] and free[i, c]):
                        continue
                    there = here + (1.4142135623730951 if i != r and j != c else 1.0)
                    if there < cost[i, j] and (i != r or j != c):
                        cost[i, j] = there
                        later = int(there) % 3
                        bucket[later, count[later]] = i * cols + j
                        count[later] += 1
        count[now] = 0
        length += 1
    for r in range(rows):
        for c in range(cols):
            if cost[r, c] > limit:
                cost[r, c] = np.inf
    return cost


@njit
def _distance_at(
    cost: FloatArray, corner: tuple[float, float], resolution: float, x: float, y: float
) -> float:
    """Return the path length from a point in meters, by the cells around it; inf = there is no path."""
    rows, cols = cost.shape
    c, r = math.floor((x - corner[0]) / resolution), math.floor((y - corner[1]) / resolution)
    best = np.inf
    for j in range(max(r - 1, 0), min(r + 2, rows)):
        for i in range(max(c - 1, 0), min(c + 2, cols)):
            dx = corner[0] + (i + 0.5) * resolution - x
            dy = corner[1] + (j + 0.5) * resolution - y
            best = min(best, cost[j, i] + math.sqrt(dx * dx + dy * dy))
    return best


def draw_goal(
    site: Site, start: Pose2, difficulty: float, rng: np.random.Generator
) -> tuple[float, float] | None:
    """Return a goal whose distance and roughness follow the difficulty; None = none found."""
    if not site.area(start.x, start.y):
        return None
    longest = PATHS[0] + difficulty * (PATHS[1] - PATHS[0])
    # Two cells of margin: only the end of the area shortens the longest path.
    ways = site.distances(start.x, start.y, longest + 2 * site.grid.resolution)
    longest = min(longest, float(ways[np.isfinite(ways)].max()))
    cells = np.argwhere((ways >= max(0.6 * longest, 1.5)) & (ways <= longest))
    if len(cells) == 0:
        return None
    goals = site.grid.centers(cells[rng.integers(len(cells), size=CANDIDATES)])
    # Mean slope of the straight lines to the goals, radians; 1 where the robot cannot stand.
    share, origin = np.linspace(0.0, 1.0, 64)[:, None], np.array((start.x, start.y))
    cells = site.grid.cells((1 - share) * origin + share * goals[:, None])
    row, col = np.moveaxis(np.clip(cells, 0, np.array(site.areas.shape) - 1), -1, 0)
    roughness = np.where(site.areas[row, col] > 0, site.slope[row, col], 1.0).mean(axis=1)
    chosen = np.argsort(roughness, kind="stable")[round(difficulty * (CANDIDATES - 1))]
    x, y = goals[chosen].tolist()
    return x, y
