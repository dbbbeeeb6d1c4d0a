"""Traversability: legal cells of a robot's center, and causes of illegal ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray
from lirs_wct.errors import SourceError
from lirs_wct.geometry import OccupancyGrid, Pose2
from lirs_wct.geometry.grid_sampling import sample_surface
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.walls import WallGrid
from lirs_wct.ground import Ground
from lirs_wct.kernels import njit

BASELINE = 0.3
"""Baseline of a slope, meters: about a wheel. Shorter steps are roughness, not slope."""
THINNED_REACH = 8
"""Nodes in half a baseline, at least, of a thinned surface; a finer one would take minutes."""

MOST_CELLS = 400_000_000
"""Limit of a grid's cells: 1.6 GB, the square of 2 km at 0.1 m."""
COARSE = 1.0
"""Node spacing above which the slope of each triangle counts, meters: short steps cannot be found."""
STEEP, WALLS = "steep ground", "a wall or a hole"
"""Causes of blocked cells."""
_STRIP = 512
"""Rows of nodes per step; without strips, a large surface would need four times its memory."""
EDGE = "the border of the world"


def traversable_by(
    ground: Ground, limits: Iterable[tuple[float, float]], resolution: float
) -> Iterator[OccupancyGrid]:
    """Yield a grid of legal positions for each pair of clearance, meters, and slope, radians.

    The grids share the filters of the ground. See `World.traversable`.

    Raises:
        SourceError: the surface is too large for a grid of this resolution.
    """
    surface = ground.surface
    west, south, east, north = surface.bounds
    shape = (max(1, math.ceil((north - south) / resolution)), max(1, math.ceil((east - west) / resolution)))
    if math.prod(shape) > MOST_CELLS:
        raise SourceError(
            f"a world of {east - west:.4g} m x {north - south:.4g} m has {math.prod(shape):.2g} cells of "
            f"{resolution:g} m to drive on, at most {MOST_CELLS:.2g} are searched: cut it (--window) or "
            "scale it (--size)"
        )
    grid = OccupancyGrid(np.zeros(shape, np.float32), resolution, Pose2(west, south))
    gradient = _gradient(surface, grid)
    found = np.logical_or.reduce([np.zeros(shape, np.bool_), *_obstacles(ground, grid).values()])
    for clearance, max_slope in limits:
        distance = distance_to(found | (gradient > math.tan(max_slope)), resolution)
        yield OccupancyGrid.from_mask(distance <= clearance, resolution, grid.origin)


def _obstacles(ground: Ground, grid: OccupancyGrid) -> dict[str, BoolArray]:
    """Return the blocked cells of a grid by cause, steep ground left out."""
    surface, walls, truth, no_ground = ground.surface, ground.walls, ground.truth, ground.no_ground
    found: dict[str, BoolArray] = {}
    if no_ground is not None:
        found["a place without ground"] = _nodes_cells(surface, no_ground, grid) | _without_ground(
            surface, no_ground, grid
        )
    if walls is not None:
        found[WALLS] = _wall_cells(walls, grid)
    if truth is not None:
        found["a cell that the map does not show as free"] = ~_lookup(
            truth.free, truth.resolution, truth.origin, grid
        )
    return found


def _gradient(surface: HeightField, grid: OccupancyGrid) -> Float32Array:
    """Return the largest relief over the baseline in each cell, meters a meter."""
    largest = np.zeros(grid.shape, np.float32)
    if surface.relief == 0:
        return largest
    if min(surface.cell) > COARSE:
        return _triangle_gradient(surface, grid)
    fine = surface if max(surface.cell) <= grid.resolution else _resample(surface, grid.resolution)
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
    """Return every n-th column and row of nodes; each holds the extreme of those up to the next ones."""
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
    """Return the row of cells of each row of nodes, and the column of cells of each column."""
    (west, south), (n_rows, n_cols) = surface.origin, surface.shape
    x = west + np.arange(n_cols) * surface.cell[0]
    y = south + np.arange(n_rows)[::-1] * surface.cell[1]
    cols = _clipped_cells(np.stack((x, np.full(n_cols, south)), axis=-1), grid)[:, 1]
    rows = _clipped_cells(np.stack((np.full(n_rows, west), y), axis=-1), grid)[:, 0]
    return rows, cols


def _without_ground(surface: HeightField, no_ground: BoolArray, grid: OccupancyGrid) -> BoolArray:
    """Mark the grid's cells whose nearest node has no ground.

    Nodes may be farther apart than cells.
    """
    at = _centers(grid)
    col = np.rint((at[..., 0] - surface.origin[0]) / surface.cell[0]).astype(np.int64)
    row = (
        surface.z.shape[0] - 1 - np.rint((at[..., 1] - surface.origin[1]) / surface.cell[1]).astype(np.int64)
    )
    found: BoolArray = no_ground[
        np.clip(row, 0, no_ground.shape[0] - 1), np.clip(col, 0, no_ground.shape[1] - 1)
    ]
    return found


def _triangle_gradient(surface: HeightField, grid: OccupancyGrid) -> Float32Array:
    """Return the gradient of the triangle at each cell's center, meters a meter."""
    shift = (grid.origin.x - surface.origin[0], grid.origin.y - surface.origin[1])
    found: Float32Array = _triangle_gradients(surface.z, surface.cell, shift, grid.resolution, *grid.shape)
    return found


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


def _resample(surface: HeightField, spacing: float) -> HeightField:
    """Return the same surface with nodes at most `spacing` apart."""
    west, south, east, north = surface.bounds
    shape = math.ceil((north - south) / spacing) + 1, math.ceil((east - west) / spacing) + 1
    return sample_surface(surface, surface.bounds, shape)


def _wall_cells(walls: WallGrid, grid: OccupancyGrid) -> BoolArray:
    """Mark the grid's cells that touch a wall or hole.

    Each grid's centers are looked up in the other grid.
    """
    barred = ~walls.floor
    local = (np.argwhere(barred)[:, ::-1] + 0.5) * walls.resolution
    marked = _lookup(barred, walls.resolution, walls.origin, grid)
    rows, cols = _clipped_cells(walls.origin.apply(local), grid).T
    marked[rows, cols] = True
    return marked


def _centers(grid: OccupancyGrid) -> FloatArray:
    rows, cols = grid.shape
    return grid.centers(np.moveaxis(np.indices((rows, cols)), 0, -1))


def overlaid(mask: BoolArray, of: OccupancyGrid, grid: OccupancyGrid) -> BoolArray:
    """Sample the mask of one grid at the cell centers of another; False outside."""
    if (of.shape, of.resolution, of.origin) == (grid.shape, grid.resolution, grid.origin):
        return mask
    return _lookup(mask, of.resolution, of.origin, grid)


def _lookup(mask: BoolArray, resolution: float, origin: Pose2, grid: OccupancyGrid) -> BoolArray:
    """Return the mask's values at the cell centers of a grid; False outside."""
    T_mask_grid = origin.inverse() @ grid.origin
    found: BoolArray = _values_at(mask, resolution, T_mask_grid.as_array(), grid.resolution, *grid.shape)
    return found


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


def _clipped_cells(points: FloatArray, grid: OccupancyGrid) -> IntArray:
    cells: IntArray = np.clip(grid.cells(points), 0, np.array(grid.shape) - 1)
    return cells


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
    """Return the cause why a robot cannot stand at a position, with amount and limit.

    Args:
        ground: ground of the world.
        grid: geometry of the cells.
        place: x and y in the world frame, meters.
        clearance: distance of the robot's center from blocked cells, meters.
        max_slope: steepest ground that the robot drives, radians.
    """
    x, y = place
    west, south, east, north = ground.surface.bounds
    away, cause, obstacle = max(0.0, min(x - west, east - x, y - south, north - y)), EDGE, EDGE
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
    """Return the free cell nearest to a position as `x,y`; None if no cell is free."""
    cells = np.argwhere(free.free)
    if len(cells) == 0:
        return None
    centers = free.centers(cells)
    x, y = centers[int(np.argmin(np.hypot(*(centers - place).T)))].tolist()
    return f"{x:.2f},{y:.2f}"
