"""Paths over grid cells: clearance, driving costs, shortest paths (Dijkstra 1959), smoothing, speeds."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import cv2
import numpy as np

from lirs_wct.errors import Checked, ConfigError, limited
from lirs_wct.geometry import BoolArray, FloatArray, IntArray, OccupancyGrid, Pose2, njit

COMFORTABLE = 0.6
"""Preferred distance of a path to blocked cells, meters."""
NO_CLEARANCE_COST = 6.0
"""Cost factor of a meter without any clearance."""
TURN = 6.0
"""Cost of a turn by 180 deg in the choice of the next goal, meters."""
ARC = 1.2
"""Radius in which the robot turns round where there is room, meters."""
STRAIGHT = 1.2
"""Meters straight ahead at the beginning of a drive, where they are free."""


def room_in(free: BoolArray, resolution: float) -> FloatArray:
    """Return (rows, cols) meters to the border or the nearest cell that is not free."""
    padded = np.pad(free, 1).astype(np.uint8)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return np.where(free, distance * resolution, 0.0)


def path_weight(free: BoolArray, room: FloatArray) -> FloatArray:
    """Return (rows, cols) the cost of a meter in each cell.

    1 with enough clearance, up to NO_CLEARANCE_COST with none, inf where not free.
    """
    lack = 1 - np.minimum(room / COMFORTABLE, 1.0)
    return np.where(free, 1 + (NO_CLEARANCE_COST - 1) * lack**2, np.inf)


def area_round(grid: OccupancyGrid, start: Pose2) -> BoolArray:
    """Return (rows, cols) the connected free area nearest to a pose."""
    _, labels = cv2.connectedComponents(grid.free.astype(np.uint8), connectivity=4)
    if not labels.any():
        raise ConfigError("a tour needs at least one free cell, got a grid without any")
    row, col = nearest(labels > 0, grid.cells((start.x, start.y)))
    area: BoolArray = labels == labels[row, col]
    return area


def nearest(mask: BoolArray, cell: IntArray) -> IntArray:
    """Return (2,) row and column of the marked cell nearest to any cell."""
    cells = np.argwhere(mask).astype(np.int64)
    closest: IntArray = cells[int(np.argmin(np.sum((cells - cell) ** 2, axis=1)))]
    return closest


def cells_ahead(grid: OccupancyGrid, free: BoolArray, start: Pose2, distance: float) -> IntArray:
    """Return cells (n, 2) straight ahead of the free cell nearest to a pose.

    The line ends after a distance in meters, or before the first cell that is not free.
    """
    first = nearest(free, grid.cells((start.x, start.y)))
    x, y = grid.centers(first).tolist()
    steps = np.arange(1, int(distance / grid.resolution) + 1) * grid.resolution
    line = Pose2(x, y, start.yaw).apply(np.column_stack((steps, np.zeros_like(steps))))
    cells = np.concatenate((first[None], grid.cells(line)))
    inside = np.all((cells >= 0) & (cells < np.array(grid.shape)), axis=1)
    row, col = np.where(inside[:, None], cells, 0).T
    blocked = np.flatnonzero(~(inside & free[row, col]))
    return cells[: blocked[0]] if len(blocked) else cells


def penalize_behind(weight: FloatArray, cell: IntArray, heading: float, radius: float) -> FloatArray:
    """Return weights with a penalty behind a robot, so that it turns in an arc.

    Args:
        weight: (rows, cols) cost of a meter in each cell.
        cell: (2,) row and column of the robot.
        heading: Heading in the grid's own frame (columns along x), radians.
        radius: Radius of the half disc behind it, cells.
    """
    reach = math.ceil(radius)
    low, high = np.maximum(cell - reach, 0), np.minimum(cell + reach + 1, weight.shape)
    box = (slice(low[0], high[0]), slice(low[1], high[1]))
    row, col = np.ogrid[box]
    distance = np.hypot(col - cell[1], row - cell[0])
    ahead = (col - cell[1]) * math.cos(heading) + (row - cell[0]) * math.sin(heading)
    changed = weight.copy()
    changed[box][(distance <= radius) & (ahead < -0.2 * distance)] *= 10.0
    return changed


@dataclass(frozen=True)
class Reach:
    """The result of a search.

    Attributes:
        cost: (rows, cols) cost from the sources in meters times weight; inf = not reached.
        parent: (rows, cols) flat index of the predecessor; -1 at a source.
    """

    cost: FloatArray
    parent: IntArray

    def path(self, cell: tuple[int, int]) -> IntArray:
        """Return (n, 2) rows and columns from a source to a reached cell, both included."""
        cols = self.parent.shape[1]
        flat = cell[0] * cols + cell[1]
        chain = [flat]
        parents = self.parent.ravel()
        while parents[flat] >= 0:
            flat = int(parents[flat])
            chain.append(flat)
        return np.stack(np.divmod(np.array(chain[::-1], dtype=np.int64), cols), axis=-1)


def search(
    weight: FloatArray,
    sources: IntArray,
    resolution: float,
    *,
    goals: BoolArray | None = None,
    slack: float = 0.0,
    limit: float = math.inf,
) -> Reach:
    """Search from sources to the eight neighbors of each cell; paths cut no blocked corners.

    Args:
        weight: (rows, cols) cost of a meter in each cell; inf = blocked.
        sources: (n, 2) rows and columns where the cost is 0.
        resolution: meters a cell.
        goals: stop when all cells up to `slack` beyond the nearest goal are settled.
        slack: extra cost beyond the nearest goal, in units of the cost.
        limit: stop at this cost.
    """
    wanted = np.zeros(weight.shape, np.bool_) if goals is None else goals
    cost, parent = np.full(weight.shape, np.inf), np.full(weight.shape, -1)
    weight = np.ascontiguousarray(weight, dtype=np.float64)
    settled = _dijkstra(weight, sources, resolution, wanted, slack, limit, cost, parent)
    cost[cost > settled] = np.inf  # that of a cell that is not settled is not yet minimal
    return Reach(cost, parent)


@njit
def _dijkstra(
    weight: FloatArray, sources: IntArray, resolution: float, goals: BoolArray, slack: float, limit: float,
    cost: FloatArray, parent: IntArray,
) -> float:  # fmt: skip
    """Fill `cost` and `parent` (rows, cols); return the cost up to which cells are settled."""
    rows, cols = weight.shape
    heap = [(0.0, np.int64(-1))]
    heap.pop()
    for k in range(len(sources)):
        r, c = sources[k, 0], sources[k, 1]
        if cost[r, c] > 0 and weight[r, c] < np.inf:
            cost[r, c] = 0.0
            heapq.heappush(heap, (0.0, r * cols + c))
    while len(heap) > 0:
        here, flat = heapq.heappop(heap)
        r, c = flat // cols, flat % cols
        if here > cost[r, c]:
            continue
        if here > limit:
            break
        if goals[r, c]:
            limit = min(limit, here + slack)
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                i, j = r + dr, c + dc
                if (dr == 0 and dc == 0) or i < 0 or j < 0 or i >= rows or j >= cols:
                    continue
                if weight[i, j] == np.inf or weight[r, j] == np.inf or weight[i, c] == np.inf:
                    continue
                step = resolution * (1.4142135623730951 if dr != 0 and dc != 0 else 1.0)
                there = here + step * 0.5 * (weight[r, c] + weight[i, j])
                if there < cost[i, j]:
                    cost[i, j] = there
                    parent[i, j] = flat
                    heapq.heappush(heap, (there, i * cols + j))
    return limit


SPACING = 0.1
"""Meters between the points of a path."""
PULLS = 250
"""Iterations of the smoothing."""


def smooth_path(
    points: FloatArray, grid: OccupancyGrid, room: FloatArray, *, keep: float, hold: int = 0
) -> FloatArray:
    """Smooth a path while it keeps its distance from blocked cells.

    Each iteration moves each point towards the middle of its neighbors (Laplacian smoothing) unless the
    new place has less room than before and less than `keep`.

    Args:
        points: (n, 2) meters in the grid's frame, in free cells.
        grid: Frame of the cells.
        room: (rows, cols) meters to the nearest blocked cell, 0 where blocked.
        keep: Room beyond which a point may move freely, meters.
        hold: Number of points at the beginning that stay where they are.
    """
    held = float(arc_length(points)[min(hold, len(points) - 1)])
    path = resample(points, SPACING)
    if len(path) < 3:
        return path
    local = grid.origin.inverse().apply(path) / grid.resolution
    tight = _pull(np.ascontiguousarray(local), room, keep, 1 + round(held / SPACING))
    return resample(grid.origin.apply(tight * grid.resolution), SPACING)


def resample(points: FloatArray, spacing: float) -> FloatArray:
    """Return points about `spacing` apart along a polyline (n, 2), both ends kept."""
    arc = arc_length(points)
    if len(points) < 2 or arc[-1] < 1e-9:
        return points[:1].copy()
    kept = np.concatenate(([True], np.diff(arc) > 1e-9))
    count = max(2, math.ceil(arc[-1] / spacing - 1e-9) + 1)
    at = np.linspace(0.0, arc[-1], count)
    return np.column_stack([np.interp(at, arc[kept], points[kept, k]) for k in range(2)])


def arc_length(points: FloatArray) -> FloatArray:
    """Return (n,) meters along a polyline (n, 2)."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))


def curvature(points: FloatArray) -> FloatArray:
    """Return (n,) 1/m: change of direction over three steps on both sides, by the distance."""
    n = len(points)
    i = np.arange(n)
    before, after = points[np.maximum(i - 3, 0)], points[np.minimum(i + 3, n - 1)]
    a, b = points - before, after - points
    turn = np.abs(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a * b, axis=1)))
    length = (np.linalg.norm(a, axis=1) + np.linalg.norm(b, axis=1)) / 2
    ends = (i == 0) | (i == n - 1) | (length < 1e-9)
    bend: FloatArray = np.where(ends, 0.0, turn / np.where(ends, 1.0, length))
    return bend


@njit
def _pull(points: FloatArray, room: FloatArray, keep: float, first: int) -> FloatArray:
    """Smooth points given in cells (column, row) from the first one on; the last stays."""
    rows, cols = room.shape
    p = points.copy()
    for _ in range(PULLS):
        for k in range(first, len(p) - 1):
            x = p[k, 0] + 0.5 * (0.5 * (p[k - 1, 0] + p[k + 1, 0]) - p[k, 0])
            y = p[k, 1] + 0.5 * (0.5 * (p[k - 1, 1] + p[k + 1, 1]) - p[k, 1])
            c, r = math.floor(x), math.floor(y)
            if r < 0 or c < 0 or r >= rows or c >= cols:
                continue
            old = room[math.floor(p[k, 1]), math.floor(p[k, 0])]
            if room[r, c] > 0 and room[r, c] >= min(old, keep):
                p[k, 0], p[k, 1] = x, y
    return p


@dataclass(frozen=True, kw_only=True)
class PursuitConfig(Checked, of="a pursuit"):
    """Speed limits and pursuit parameters.

    Attributes:
        speed: Speed on straight level ground, m/s.
        turn_rate: Largest turn rate, rad/s.
        acceleration: Acceleration along the path, speeding up and braking, m/s^2.
        lookahead: Distance of the pursued point when slow, meters; it grows with the speed.
        lookahead_time: Seconds of travel added to the lookahead.
        turn_in_place: Heading error above which the robot stops and turns, radians.
        careful_room: Distance to blocked cells below which it drives slower, meters.
        careful_speed: Share of the speed where there is no room or the ground is steep.
        steep: Slope along the path above which the speed falls, radians; lowest at twice the slope.
    """

    speed: float = limited(0.8, "(0, inf]")
    turn_rate: float = limited(1.2, "(0, inf]")
    acceleration: float = limited(0.6, "(0, inf]")
    lookahead: float = limited(0.35, "(0, inf]")
    lookahead_time: float = limited(0.5, "(0, inf]")
    turn_in_place: float = limited(1.0, "(0, inf]")
    careful_room: float = limited(0.3, "(0, inf]")
    careful_speed: float = limited(0.6, "(0, inf]")
    steep: float = limited(math.radians(8), "(0, inf]")


def speed_profile(
    points: FloatArray,
    grid: OccupancyGrid,
    room: FloatArray,
    config: PursuitConfig,
    height: FloatArray | None = None,
) -> FloatArray:
    """Return (n,) m/s along a path: slow in bends, narrow places and on slopes.

    Args:
        points: (n, 2) meters in the grid's frame, evenly spaced.
        grid: Frame of the cells.
        room: (rows, cols) meters to the nearest blocked cell.
        config: Limits of the speed.
        height: (n,) meters of the ground, where slopes matter.
    """
    speed = np.minimum(config.speed, 0.7 * config.turn_rate / np.maximum(curvature(points), 1e-6))
    cells = np.clip(grid.cells(points), 0, np.array(room.shape) - 1)
    care = np.clip(room[cells[:, 0], cells[:, 1]] / config.careful_room, 0.0, 1.0)
    if height is not None and len(points) > 1:
        slope = np.abs(np.arctan2(np.gradient(height), np.maximum(np.gradient(arc_length(points)), 1e-6)))
        care = np.minimum(care, np.clip(2.0 - slope / config.steep, 0.0, 1.0))
    speed = np.minimum(speed, config.speed * (config.careful_speed + (1 - config.careful_speed) * care))
    squared = np.square(np.maximum(speed, 0.15 * config.speed)).tolist()
    gain = 2 * config.acceleration * SPACING
    squared[-1] = min(squared[-1], gain)
    for k in range(1, len(squared)):
        squared[k] = min(squared[k], squared[k - 1] + gain)
    for k in range(len(squared) - 2, -1, -1):
        squared[k] = min(squared[k], squared[k + 1] + gain)
    profile: FloatArray = np.sqrt(squared)
    return profile


@dataclass(frozen=True)
class Path:
    """A path to drive.

    Attributes:
        points: (n, 2) meters, about 0.1 m apart, in the driver's frame.
        speed: (n,) m/s.
        yaw: Heading at its end, radians; None = as it comes.
    """

    points: FloatArray
    speed: FloatArray
    yaw: float | None = None
