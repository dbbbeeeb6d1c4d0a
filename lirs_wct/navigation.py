"""Navigation: legal cells of a robot's center, causes of illegal ones, and spawn poses."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError
from lirs_wct.geometry import (
    BoolArray,
    Float32Array,
    FloatArray,
    HeightField,
    IntArray,
    OccupancyGrid,
    Pose2,
    WallGrid,
    njit,
    sample_surface,
)
from lirs_wct.ground import Ground

BASELINE = 0.3
"""Baseline of a slope, meters: about a wheel. Shorter steps are roughness, not slope."""
THINNED_REACH = 8
"""Nodes in half a baseline, at least, of a thinned surface; a finer one would take minutes."""

MAX_CELLS = 400_000_000
"""Limit of a grid's cells: 1.6 GB, the square of 2 km at 0.1 m."""
COARSE_CELL = 1.0
"""Node spacing above which the slope of each triangle counts, meters: short steps cannot be found."""
STEEP, WALLS = "steep ground", "a wall or a hole"
"""Causes of blocked cells."""
_STRIP = 512
"""Rows of nodes per step; without strips, a large surface would need four times its memory."""
BORDER = "the border of the world"


def traversable_by(
    ground: Ground, limits: Iterable[tuple[float, float]], resolution: float
) -> Iterator[OccupancyGrid]:
    """Yield a grid of legal positions for each pair of clearance, meters, and slope, radians.

    The grids share the filters of the ground. See `World.traversable`.
    """
    surface = ground.surface
    west, south, east, north = surface.bounds
    shape = (max(1, math.ceil((north - south) / resolution)), max(1, math.ceil((east - west) / resolution)))
    if math.prod(shape) > MAX_CELLS:
        raise SourceError(
            f"a world of {east - west:.4g} m x {north - south:.4g} m has {math.prod(shape):.2g} cells of "
            f"{resolution:g} m to drive on, at most {MAX_CELLS:.2g} are searched: cut it (--window) or "
            "scale it (--size)"
        )
    grid = OccupancyGrid(np.zeros(shape, np.float32), resolution, Pose2(west, south))
    gradient = _gradient(surface, grid)
    obstacles = np.logical_or.reduce([np.zeros(shape, np.bool_), *_obstacles(ground, grid).values()])
    for clearance, max_slope in limits:
        distance = distance_to(obstacles | (gradient > math.tan(max_slope)), resolution)
        yield OccupancyGrid.from_mask(distance <= clearance, resolution, grid.origin)


def _obstacles(ground: Ground, grid: OccupancyGrid) -> dict[str, BoolArray]:
    """Return the blocked cells of a grid by cause, steep ground left out."""
    surface, truth, no_ground = ground.surface, ground.truth, ground.no_ground
    obstacles: dict[str, BoolArray] = {}
    if no_ground is not None:
        gaps = _nodes_cells(surface, no_ground, grid) | _without_ground(surface, no_ground, grid)
        obstacles["a place without ground"] = gaps
    if ground.walls is not None:
        obstacles[WALLS] = _wall_cells(ground.walls, grid)
    if truth is not None:
        obstacles["a cell that the map does not show as free"] = ~overlaid(truth.free, truth, grid)
    return obstacles


def _gradient(surface: HeightField, grid: OccupancyGrid) -> Float32Array:
    """Return the largest relief over the baseline in each cell, meters a meter."""
    largest = np.zeros(grid.shape, np.float32)
    if surface.relief == 0:
        return largest
    if min(surface.cell) > COARSE_CELL:
        shift = (grid.origin.x - surface.origin[0], grid.origin.y - surface.origin[1])
        steepness: Float32Array = _triangle_gradients(
            surface.z, surface.cell, shift, grid.resolution, *grid.shape
        )
        return steepness
    fine = surface
    if max(surface.cell) > grid.resolution:
        west, south, east, north = surface.bounds
        n_rows, n_cols = (math.ceil(side / grid.resolution) + 1 for side in (north - south, east - west))
        fine = sample_surface(surface, surface.bounds, (n_rows, n_cols))
    every = [max(1, int(BASELINE / 2 / c) // THINNED_REACH) for c in fine.cell]
    high, low = _thin(fine, every, cv2.dilate), _thin(fine, every, cv2.erode)
    # A thinned node holds the extreme of its neighbors up to `spread` meters away.
    spread = [(n - 1) * c for n, c in zip(every, fine.cell, strict=True)]
    reach = [max(1, round((BASELINE / 2 - s) / c)) for s, c in zip(spread, high.cell, strict=True)]
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach[0] + 1, 2 * reach[1] + 1))
    baseline = 2 * max(r * c + s for r, c, s in zip(reach, high.cell, spread, strict=True))
    rows, cols = _node_rows_cols(high, grid)
    first = np.flatnonzero(np.diff(cols, prepend=-1))
    for start in range(0, len(rows), _STRIP):
        # A strip needs the rows within reach of it.
        above = min(start, reach[1])
        part = slice(start - above, start + _STRIP + reach[1])
        relief = cv2.dilate(high.z[part], kernel) - cv2.erode(low.z[part], kernel)
        strip = relief[above : above + len(rows[start : start + _STRIP])] / np.float32(baseline)
        # Neighboring nodes share a cell.
        for row, values in zip(rows[start:], np.maximum.reduceat(strip, first, axis=1), strict=False):
            largest[row, cols[first]] = np.maximum(largest[row, cols[first]], values)
    return largest


def _thin(
    surface: HeightField, every: list[int], extreme: Callable[[Float32Array, NDArray[np.uint8]], Any]
) -> HeightField:
    """Return every n-th column and row of nodes, each the extreme of its neighbors."""
    n, m = every
    if n == m == 1:
        return surface
    z = extreme(surface.z, np.ones((2 * m - 1, 2 * n - 1), np.uint8))
    dx, dy = surface.cell
    return HeightField(z[::-1][::m, ::n][::-1], (n * dx, m * dy), surface.origin)


def _nodes_cells(surface: HeightField, chosen: BoolArray, grid: OccupancyGrid) -> BoolArray:
    """Mark the cells that contain chosen nodes; the grid is axis-parallel.

    Each row of nodes lies in one row of cells.
    """
    rows, cols = _node_rows_cols(surface, grid)
    marked = np.zeros(grid.shape, np.bool_)
    for row, nodes in zip(rows, chosen, strict=True):
        marked[row, cols[nodes]] = True
    return marked


def _node_rows_cols(surface: HeightField, grid: OccupancyGrid) -> tuple[IntArray, IntArray]:
    """Return the rows and columns of cells of the rows and columns of nodes."""
    (west, south), (n_rows, n_cols) = surface.origin, surface.shape
    x = west + np.arange(n_cols) * surface.cell[0]
    y = south + np.arange(n_rows)[::-1] * surface.cell[1]
    cols = grid.cells(np.stack((x, np.full(n_cols, south)), axis=-1))[:, 1]
    rows = grid.cells(np.stack((np.full(n_rows, west), y), axis=-1))[:, 0]
    return np.clip(rows, 0, grid.shape[0] - 1), np.clip(cols, 0, grid.shape[1] - 1)


def _without_ground(surface: HeightField, no_ground: BoolArray, grid: OccupancyGrid) -> BoolArray:
    """Mark cells whose nearest node has no ground; nodes may lie farther apart."""
    col, row = (
        np.rint((start + (np.arange(n) + 0.5) * grid.resolution - first) / step).astype(np.int64)
        for start, n, first, step in zip(
            (grid.origin.x, grid.origin.y), grid.shape[::-1], surface.origin, surface.cell, strict=True
        )
    )
    row = surface.shape[0] - 1 - row
    last_row, last_col = no_ground.shape[0] - 1, no_ground.shape[1] - 1
    marked: BoolArray = no_ground[np.ix_(np.clip(row, 0, last_row), np.clip(col, 0, last_col))]
    return marked


@njit
def _triangle_gradients(
    z: Float32Array, cell: tuple[float, float], shift: tuple[float, float], step: float, rows: int, cols: int
) -> Float32Array:
    """Return (rows, cols) gradients at the cell centers, which are `step` meters apart."""
    found = np.empty((rows, cols), np.float32)
    last, right = z.shape[0] - 1, z.shape[1] - 2
    for row in range(rows):
        v = (shift[1] + (row + 0.5) * step) / cell[1]
        j = min(max(int(v), 0), last - 1)
        for col in range(cols):
            u = (shift[0] + (col + 0.5) * step) / cell[0]
            i = min(max(int(u), 0), right)
            sw, se = z[last - j, i], z[last - j, i + 1]
            nw, ne = z[last - j - 1, i], z[last - j - 1, i + 1]
            if u - i >= v - j:
                dx, dy = (se - sw) / cell[0], (ne - se) / cell[1]
            else:
                dx, dy = (ne - nw) / cell[0], (nw - sw) / cell[1]
            found[row, col] = math.hypot(dx, dy)
    return found


def _wall_cells(walls: WallGrid, grid: OccupancyGrid) -> BoolArray:
    """Mark the grid's cells that touch a wall or hole.

    Each grid's centers are looked up in the other grid.
    """
    barred = ~walls.floor
    local = (np.argwhere(barred)[:, ::-1] + 0.5) * walls.resolution
    marked = overlaid(barred, walls, grid)
    cells = grid.cells(walls.origin.apply(local))
    rows, cols = np.clip(cells, 0, np.array(grid.shape) - 1).T
    marked[rows, cols] = True
    return marked


def overlaid(mask: BoolArray, of: OccupancyGrid | WallGrid, grid: OccupancyGrid) -> BoolArray:
    """Sample the mask of one grid at the cell centers of another; False outside."""
    if (of.shape, of.resolution, of.origin) == (grid.shape, grid.resolution, grid.origin):
        return mask
    T_mask_grid = (of.origin.inverse() @ grid.origin).as_array()
    values: BoolArray = _values_at(mask, of.resolution, T_mask_grid, grid.resolution, *grid.shape)
    return values


@njit
def _values_at(
    mask: BoolArray, resolution: float, T_mask_grid: FloatArray, step: float, rows: int, cols: int
) -> BoolArray:
    """Return (rows, cols) values of a mask at cell centers `step` meters apart; False outside."""
    x0, y0, yaw = T_mask_grid
    c, s = math.cos(yaw), math.sin(yaw)
    found = np.zeros((rows, cols), np.bool_)
    for row in range(rows):
        for col in range(cols):
            x, y = (col + 0.5) * step, (row + 0.5) * step
            at_col = math.floor((x0 + c * x - s * y) / resolution)
            at_row = math.floor((y0 + s * x + c * y) / resolution)
            if 0 <= at_row < mask.shape[0] and 0 <= at_col < mask.shape[1]:
                found[row, col] = mask[at_row, at_col]
    return found


def distance_to(blocked: BoolArray, resolution: float) -> FloatArray:
    """Return the distance from each cell to the nearest blocked one, meters.

    Everything beyond the border is blocked.
    """
    padded = np.pad(~blocked, 1).view(np.uint8)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    meters: FloatArray = distance[1:-1, 1:-1].astype(np.float64)
    meters *= resolution
    return meters


def cause_of_refusal(
    ground: Ground, grid: OccupancyGrid, place: tuple[float, float], *, clearance: float, max_slope: float
) -> str:
    """Return the cause why a robot cannot stand at a place, with amount and limit.

    The grid gives the geometry of the cells; for clearance and slope see `World.traversable`.
    """
    x, y = place
    west, south, east, north = ground.surface.bounds
    away, cause, obstacle = max(0.0, min(x - west, east - x, y - south, north - y)), BORDER, BORDER
    gradient = _gradient(ground.surface, grid)
    for blocking, mask in ({STEEP: gradient > math.tan(max_slope)} | _obstacles(ground, grid)).items():
        cells = np.argwhere(mask)
        if len(cells) == 0:
            continue
        gap = np.maximum(np.abs(grid.centers(cells) - place) - grid.resolution / 2, 0.0)
        distance = np.hypot(*gap.T)
        nearest = int(np.argmin(distance))
        if distance[nearest] < away:
            away, cause, obstacle = float(distance[nearest]), blocking, blocking
            if cause == STEEP:
                slope = math.degrees(math.atan(gradient[tuple(cells[nearest])]))
                obstacle = f"ground of {slope:.3g} deg (limit {math.degrees(max_slope):.3g})"
    if away > 0:
        return f"it is {away:.2f} m from {obstacle}, its center needs {clearance:.2f} m"
    return f"it is {'in' if cause == WALLS else 'on'} {obstacle}"


def nearest_place(free: OccupancyGrid, place: tuple[float, float]) -> str | None:
    """Return the nearest free cell as `x,y`; None if no cell is free."""
    cells = np.argwhere(free.free)
    if len(cells) == 0:
        return None
    centers = free.centers(cells)
    x, y = centers[int(np.argmin(np.hypot(*(centers - place).T)))].tolist()
    return f"{x:.2f},{y:.2f}"


START_CLEARANCE = 0.22
"""Free ground beyond a robot's radius at a roomy start, meters."""
TIGHT_MARGIN = 0.15
"""The same without a roomy start, meters; path planning keeps this margin."""
GENTLE = math.radians(12)
"""Steepest ground of a roomy start, radians, even if the robot can drive steeper ground."""


@dataclass(frozen=True)
class Footprint:
    """Size and slope limit of a robot.

    Attributes:
        robot: name of the robot.
        radius: radius of its enclosing circle, meters.
        max_slope: steepest ground that it drives, radians.
    """

    robot: str
    radius: float
    max_slope: float

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Clearance (meters) and slope (radians) of a roomy start, then of any start."""
        return (
            (round(self.radius + START_CLEARANCE, 6), min(self.max_slope, GENTLE)),
            (round(self.radius + TIGHT_MARGIN, 6), self.max_slope),
        )


ROBOTS = tomllib.loads(files("lirs_wct").joinpath("robots.toml").read_text(encoding="utf-8"))
FOOTPRINTS = tuple(
    Footprint(name, figures["radius"], math.radians(figures["max_slope"]))
    for name, figures in sorted(ROBOTS.items(), key=lambda item: -item[1]["radius"])
    if "left_wheels" in figures
)
"""Wheeled robots, the largest first."""


RIM_SHARE = 0.15
"""Share of the free area's extent on each side without start poses."""
MIN_VIEW = 1.0
"""Free distance ahead of a robot's center at its start, meters."""
VIEW_REACH, DIRECTIONS = 20.0, 24
"""Range (meters) and number of directions of the search for the longest view."""
MIN_EXTENT_SHARE = 0.05
"""Share of the largest enclosed extent below which an area counts as closet or scan gap."""
ORIGIN_REACH = 1.0
"""Distance from the origin of a map's frame within which an area counts as being at the origin, meters."""


def spawn_poses(free: OccupancyGrid, count: int = 8, *, corridors: bool = False) -> tuple[Pose2, ...]:
    """Return up to `count` poses on the largest connected free area, the roomiest first.

    Each pose faces the center of that area and lies in its inner part, because a robot at the edge of the
    world sees little of it. The method is farthest-point sampling: the same grid gives the same poses.

    Args:
        free: grid whose free cells are legal positions of a robot's center.
        count: largest number of poses.
        corridors: whether a pose that would face a wall turns to its longest view instead.
    """
    area = _inner(largest_area(free.free))
    points = free.centers(np.argwhere(area))
    if len(points) == 0:
        return ()
    room = distance_to(~area, free.resolution)[area]
    middle = points.mean(axis=0)
    chosen = [int(np.argmax(np.minimum(room, 3.0) - 0.02 * np.hypot(*(points - middle).T)))]
    gap = np.full(len(points), np.inf)
    while len(chosen) < min(count, len(points)):
        gap = np.minimum(gap, np.hypot(*(points - points[chosen[-1]]).T))
        chosen.append(int(np.argmax(gap + np.minimum(room, 2.0))))
    poses = []
    for point in points[chosen]:
        dx, dy = (middle - point).tolist()
        yaw = math.atan2(dy, dx) if math.hypot(dx, dy) > 1e-9 else 0.0
        if corridors and min(MIN_VIEW, math.hypot(dx, dy)) > _view(free, point, yaw, MIN_VIEW):
            directions = [2 * math.pi * k / DIRECTIONS - math.pi for k in range(DIRECTIONS)]
            yaw = max(directions, key=lambda direction: _view(free, point, direction, VIEW_REACH))
        poses.append(Pose2(float(point[0]), float(point[1]), yaw))
    return tuple(poses)


def _inner(area: BoolArray) -> BoolArray:
    """Return the part of an area away from its ends, or all of it."""
    inner = area.copy()
    for axis in (0, 1):
        filled = np.flatnonzero(area.any(axis=1 - axis))
        if len(filled) == 0:
            return area
        low, high = int(filled[0]), int(filled[-1])
        at = np.arange(area.shape[axis])
        outside = (at < low + RIM_SHARE * (high - low)) | (at > high - RIM_SHARE * (high - low))
        inner[(outside, slice(None)) if axis == 0 else (slice(None), outside)] = False
    return inner if inner.any() else area


def _view(free: OccupancyGrid, point: FloatArray, yaw: float, reach: float) -> float:
    """Return the free distance ahead of a point, at most `reach`, meters."""
    steps = np.arange(0.0, reach + free.resolution / 2, free.resolution / 2)
    ahead = point + steps[:, None] * np.array((math.cos(yaw), math.sin(yaw)))
    rows, cols = free.cells(ahead).T
    inside = (rows >= 0) & (rows < free.shape[0]) & (cols >= 0) & (cols < free.shape[1])
    blocked = ~inside
    blocked[inside] = free.log_odds[rows[inside], cols[inside]] >= 0
    return float(steps[np.argmax(blocked)]) if blocked.any() else reach


def largest_area(mask: BoolArray) -> BoolArray:
    """Return the largest 4-connected area of a mask; all False if the mask is empty."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    if len(sizes) == 0:
        return np.zeros_like(mask)
    area: BoolArray = labels == 1 + int(np.argmax(sizes))
    return area


def mapped_area(free: OccupancyGrid, border: float) -> BoolArray:
    """Return (rows, cols) whether a cell is in the area where the map was recorded.

    This is the free area at the origin of the map's frame, where the mapping robot started. If nothing is
    free there, it is the area with the largest extent, islands included, that walls separate from the map's
    border: a race track, not its infield and not the space outside. All False if no cell is free.

    Args:
        free: grid whose free cells are legal positions of a small robot's center.
        border: distance that such a robot keeps from the border, meters.
    """
    mask = free.free
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    if len(stats) == 1:
        return np.zeros_like(mask)
    extent = _extents(labels, stats)
    large = extent >= MIN_EXTENT_SHARE * extent.max()
    begun = _label_at_origin(free, labels, mask)
    if begun and large[begun - 1]:
        return np.asarray(labels == begun)
    reach = round(border / free.resolution) + 1
    rows, cols = mask.shape
    left, top, width, height = stats[1:, :4].T
    outside = (
        (left <= reach) | (top <= reach) | (left + width >= cols - reach) | (top + height >= rows - reach)
    )
    inside = large & ~outside
    chosen = int(np.argmax(np.where(inside if inside.any() else large, extent, -1.0)))
    return np.asarray(labels == 1 + chosen)


def _extents(labels: IntArray, stats: IntArray) -> Float32Array:
    """Return the number of cells within each area's outer contour.

    Small areas count the cells of their bounding box.
    """
    extents = (stats[1:, cv2.CC_STAT_WIDTH] * stats[1:, cv2.CC_STAT_HEIGHT]).astype(np.float32)
    for k in np.flatnonzero(extents >= MIN_EXTENT_SHARE * extents.max()):
        left, top, width, height = stats[1 + k, :4].tolist()
        part = (labels[top : top + height, left : left + width] == 1 + k).astype(np.uint8)
        contours, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        extents[k] = sum(cv2.contourArea(contour) for contour in contours)
    return extents


def _label_at_origin(free: OccupancyGrid, labels: IntArray, mask: BoolArray) -> int:
    """Return the label of the free cell near the frame's origin; 0 if none is."""
    row, col = free.cells((0.0, 0.0)).tolist()
    reach = round(ORIGIN_REACH / free.resolution)
    r0, c0 = max(0, row - reach), max(0, col - reach)
    near = mask[r0 : max(0, row + reach + 1), c0 : max(0, col + reach + 1)]
    cells = np.argwhere(near) + np.array((r0, c0))
    if len(cells) == 0:
        return 0
    distance = np.hypot(cells[:, 0] - row, cells[:, 1] - col)
    if distance.min() > reach:
        return 0
    nearest = cells[int(np.argmin(distance))]
    return int(labels[nearest[0], nearest[1]])
