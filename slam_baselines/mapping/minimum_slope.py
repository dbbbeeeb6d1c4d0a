"""The minimum slope of a hit: how steeply the ground must rise to it from what lies near, rise over run.

The formula is that of the ground filter. Few neighbors raise a slope: blocks of cells with their lowest upper
bound rule out many at once. Weights for matching ask only for slopes from that of a wall on, and up to that
of full weight.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import ByteArray, Float32Array, FloatArray, IntArray
from lirs_wct.kernels import njit
from slam_baselines.mapping.occupancy_map import SLOPE_STEP

BLOCK_BITS = 3
"""A block is 8 x 8 cells of the upper bound."""


Limits = tuple[float, float]
"""Slopes below the first and from the second on need not be told apart, SLOPE_STEP."""
IN_FULL: Limits = (0.0, 255.0)


class Neighbors(NamedTuple):
    """Cells around a hit: all close by, fewer farther off.

    Attributes:
        cell: (k, 2) row and column offsets: those close by, then those farther off, both by distance.
        distance: (k,) of their middles, and a cell's edge, meters.
        close: number of those close by.
        close_reach: largest offset among them.
        reach: largest offset of all.
    """

    cell: IntArray
    distance: FloatArray
    close: int
    close_reach: int
    reach: int


class UpperBound(NamedTuple):
    """Upper bound of the ground's height for the kernels, meters; inf where nothing was seen.

    Attributes:
        cells: (rows, cols) of each cell.
        blocks: (rows / 8, cols / 8) smallest of each block of cells.
        frame: (3,) lattice row and column of cell (0, 0), resolution in meters.
        neighbors: of a hit.
    """

    cells: Float32Array
    blocks: Float32Array
    frame: FloatArray
    neighbors: Neighbors


class DrawnSlopes(NamedTuple):
    """Minimum slopes of a map's cells.

    Attributes:
        layer: (rows, cols) SLOPE_STEP.
        frame: (3,) lattice row and column of cell (0, 0), resolution in meters.
    """

    layer: ByteArray
    frame: FloatArray


NOT_DRAWN = DrawnSlopes(np.zeros((0, 0), np.uint8), np.array((0.0, 0.0, 1.0)))
"""Of a map without cells."""


class Margins(NamedTuple):
    """How far heights may be wrong.

    Attributes:
        old: what the robot's height may have drifted since the start, meters.
        near: of a hit close to the laser, meters.
        far: what a hit's height may be wrong by more per meter of range.
    """

    old: float
    near: float
    far: float


def neighbors_of(resolution: float) -> Neighbors:
    """Return the cells that tell how high the ground before a hit can be."""
    reach = round(0.35 / resolution)
    close = [(r, c) for r in range(-reach, reach + 1) for c in range(-reach, reach + 1)]
    rays = [(math.sin(a), math.cos(a)) for a in np.arange(12) * math.tau / 12]
    rings = [(round(d * s / resolution), round(d * c / resolution)) for d in (0.5, 0.8, 1.2) for s, c in rays]
    near_to_far = sorted(close, key=_length) + sorted(rings, key=_length)
    cells = np.array(near_to_far, np.int64)
    distance = np.array([_length(cell) * resolution + resolution for cell in near_to_far])
    return Neighbors(cells, distance, len(close), reach, int(np.abs(cells).max()))


def _length(cell: tuple[int, int]) -> float:
    return math.hypot(*cell)


def blocks_of(cells: Float32Array) -> Float32Array:
    """Return the smallest upper bound of each block of cells."""
    size = 1 << BLOCK_BITS
    rows, cols = cells.shape
    of_rows = cells.reshape(rows // size, size, cols).min(axis=1)
    lowest: Float32Array = of_rows.reshape(rows // size, cols // size, size).min(axis=2)
    return lowest


def limits_for_weights(wall_slope: int, full_weight_slope: float) -> Limits:
    """Return the slopes between which weights differ, of a wall and of full weight, SLOPE_STEP."""
    return float(wall_slope), min(255.0, max(float(wall_slope), full_weight_slope / SLOPE_STEP + 1.0))


@njit(cache=True, nogil=True)
def lower(upper_bound: Any, row: int, col: int, z: Any) -> None:
    """Lower the upper bound of a cell, and of its block, to z if it is above."""
    r, c = np.uintp(row), np.uintp(col)
    if z < upper_bound.cells[r, c]:
        upper_bound.cells[r, c] = z
        r, c = np.uintp(row >> BLOCK_BITS), np.uintp(col >> BLOCK_BITS)
        upper_bound.blocks[r, c] = min(upper_bound.blocks[r, c], z)


@njit(cache=True, nogil=True)
def raise_min_slopes(
    upper_bound: Any, origin: Any, hits: Any, pose: Any, ground: Any, margins: Any, limits: Any, drawn: Any,
    slopes: Any,
) -> None:  # fmt: skip
    """Raise minimum slopes to the largest rise over run that must lie before each hit.

    Args:
        upper_bound: of the ground.
        origin: (3,) the laser, meters.
        hits: (n, 3) ends of beams in the same frame.
        pose: x, y, yaw, z of this frame in that of the map.
        ground: x, y, z of the highest that the ground under the robot may be.
        margins: of the heights.
        limits: slopes below the first and from the second on need not be told apart, SLOPE_STEP.
        drawn: what a map knows of its cells.
        slopes: (n,) what is known of the hits before; raised in place, SLOPE_STEP.
    """
    cells, blocks, frame, neighbors = upper_bound
    layer, known = drawn
    x0, y0, yaw, z0 = pose
    c, s, res = np.cos(yaw), np.sin(yaw), frame[2]
    laser_x, laser_y = x0 + c * origin[0] - s * origin[1], y0 + s * origin[0] + c * origin[1]
    laser_z = z0 + origin[2]
    # Half a step is more than any rounding.
    least, most = max(0.0, (limits[0] - 0.5) * SLOPE_STEP), (limits[1] + 0.5) * SLOPE_STEP
    for i in range(len(hits)):
        u, v = hits[i, 0], hits[i, 1]
        x, y, z = x0 + c * u - s * v, y0 + s * u + c * v, z0 + hits[i, 2]
        row, col = int(np.floor(y / known[2] - known[0])), int(np.floor(x / known[2] - known[1]))
        if 0 <= row < layer.shape[0] and 0 <= col < layer.shape[1]:
            slopes[i] = max(slopes[i], layer[row, col])
        best = max(least, slopes[i] * SLOPE_STEP)
        if best >= most:
            continue
        z -= margins.near + margins.far * np.sqrt(
            (x - laser_x) ** 2 + (y - laser_y) ** 2 + (z - laser_z) ** 2
        )
        dx, dy, rise = x - ground[0], y - ground[1], z - ground[2]
        if rise > best * (max(abs(dx), abs(dy)) + res):
            best = max(best, rise / (np.hypot(dx, dy) + res))
        best = _steepest(cells, blocks, frame, neighbors, x, y, z - margins.old, best, most)
        slopes[i] = max(slopes[i], np.uint8(min(best / SLOPE_STEP, 255.0)))


@njit(cache=True, nogil=True, forceinline=True)
def _steepest(
    cells: Any,
    blocks: Any,
    frame: Any,
    neighbors: Any,
    x: float,
    y: float,
    z: float,
    best: float,
    most: float,
) -> float:
    """Return the largest rise over run from cells around (x, y) to z; at least `best`, told up to `most`."""
    rows, cols = cells.shape
    cell, distance, close, close_reach, reach = neighbors
    row, col = int(np.floor(y / frame[2] - frame[0])), int(np.floor(x / frame[2] - frame[1]))
    if not (reach <= row < rows - reach and reach <= col < cols - reach):
        for k in range(len(cell)):
            r, c = row + cell[k, 0], col + cell[k, 1]
            if 0 <= r < rows and 0 <= c < cols:
                best = max(best, (z - cells[r, c]) / distance[k])
        return best
    for first, end, around in ((0, close, close_reach), (close, len(cell), reach)):
        most_rise = z - _lowest(blocks, row, col, around)
        for k in range(first, end):
            # A product asks what a quotient, four times as slow, would; few cells raise the slope.
            needed = best * distance[k]
            if most_rise <= needed:
                break
            rise = z - cells[np.uintp(row + cell[k, 0]), np.uintp(col + cell[k, 1])]
            if rise > needed:
                best = max(best, rise / distance[k])
                if best >= most:
                    return best
    return best


@njit(cache=True, nogil=True, forceinline=True)
def _lowest(blocks: Any, row: int, col: int, reach: int) -> Any:
    """Return the smallest upper bound of the blocks that hold the cells up to `reach` from a cell."""
    lowest = np.float32(np.inf)
    for r in range((row - reach) >> BLOCK_BITS, ((row + reach) >> BLOCK_BITS) + 1):
        for c in range((col - reach) >> BLOCK_BITS, ((col + reach) >> BLOCK_BITS) + 1):
            lowest = min(lowest, blocks[np.uintp(r), np.uintp(c)])
    return lowest
