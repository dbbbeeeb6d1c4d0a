"""The ground that lidars have seen, a grid for each of N robots."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lirs_envs.lidar.clipping import FAR, inverse
from lirs_envs.lidar.lidar import transform_rays
from lirs_envs.tasks.site import SEEN_CELL, SeenFrame
from lirs_wct.arrays import BoolArray, ByteArray, Float32Array, FloatArray
from lirs_wct.geometry.pose import Pose3

DONE = np.float32(-np.inf)
"""Height below which no beam passes: there is nothing to be seen, or it was seen."""
LEVEL = 3
BLOCK = 2**LEVEL
"""Cells along the side of a block."""


class SeenGround:
    """Cells over whose ground a beam passed at most `reach` above it, or on which it ended; from true poses.

    Attributes:
        cells: (N,) number of seen cells.
        wanted_cells: (N,) number of seen cells among the wanted ones.

    Args:
        count: number of robots, N.
        beams: (n, 3) directions of the beams in the base's frame, unit vectors.
        mount: (3,) the lidar in the base's frame, metres.
        reach: metres.
    """

    def __init__(self, count: int, beams: FloatArray, mount: FloatArray, reach: float) -> None:
        self._beams, self._mount, self._reach = beams, mount[None], reach
        self._ceilings: list[Float32Array] = [np.zeros((0, 0), np.float32)] * count
        self._highest = list(self._ceilings)
        self._ground: list[BoolArray] = [np.zeros((0, 0), np.bool_)] * count
        self._wanted: list[BoolArray] = [np.zeros((0, 0), np.bool_)] * count
        self._corners = [(0.0, 0.0)] * count
        self.cells = np.zeros(count, np.int64)
        self.wanted_cells = np.zeros(count, np.int64)

    def begin(self, i: int, frame: SeenFrame, wanted: BoolArray) -> None:
        """Begin anew for robot `i`, which has seen nothing; `wanted` (rows, cols) cells are counted apart."""
        self._ceilings[i] = frame.height + np.float32(self._reach)
        self._highest[i] = _highest_of_blocks(self._ceilings[i])
        self._ground[i] = np.isfinite(frame.height)
        self._wanted[i], self._corners[i] = wanted, frame.corner
        self.cells[i] = self.wanted_cells[i] = 0

    def add(self, i: int, ranges: Float32Array, range_max: float, T_world_base: Pose3) -> None:
        """Mark what the beams of robot `i` saw; one without return sees its whole range."""
        T, (x, y) = T_world_base, self._corners[i]
        origin, directions = np.empty((1, 3)), np.empty_like(self._beams)
        transform_rays(
            (T.qw, T.qx, T.qy, T.qz), (T.x, T.y, T.z), self._mount, self._beams, origin, directions
        )
        start = (
            float(origin[0, 0] - x) / SEEN_CELL,
            float(origin[0, 1] - y) / SEEN_CELL,
            float(origin[0, 2]),
        )
        cells, wanted = mark_seen(
            self._ceilings[i], self._highest[i], self._wanted[i], start, directions, ranges, range_max
        )
        self.cells[i] += cells
        self.wanted_cells[i] += wanted

    def seen(self, i: int) -> BoolArray:
        """Return (rows, cols) the cells that robot `i` has seen, row 0 = south."""
        seen: BoolArray = self._ground[i] & (self._ceilings[i] == DONE)
        return seen

    def local_map(self, i: int, x: float, y: float, yaw: float, out: ByteArray) -> None:
        """Fill (n, n): 255 = seen; the robot in the middle, row 0 = ahead, column 0 = left."""
        _crop(self._ceilings[i], self._ground[i], self._corners[i], (x, y, yaw), out)


@njit(cache=True, nogil=True, error_model="numpy")
def mark_seen(
    ceiling: Float32Array,
    highest: Float32Array,
    wanted: BoolArray,
    start: tuple[float, float, float],
    directions: FloatArray,
    ranges: Float32Array,
    range_max: float,
) -> tuple[int, int]:
    """Set the ceiling of each cell that a beam passes below it to -inf; return how many, and wanted ones.

    Cells are those that a beam crosses in the plane (Amanatides and Woo, "A fast voxel traversal algorithm
    for ray tracing", 1987); its height is that in the middle of the crossing. A beam leaps over blocks of
    cells above whose highest ceiling it stays.

    Args:
        ceiling: (rows, cols) height up to which a beam sees the cell's ground, metres.
        highest: (rows / BLOCK, cols / BLOCK) highest ceiling in each block of cells.
        wanted: (rows, cols) cells that are counted apart.
        start: of all beams: u and v in cells from the grid's corner, z in metres.
        directions: (n, 3) of the beams in the world, unit vectors.
        ranges: (n,) metres (see `LaserScan`).
        range_max: metres.
    """
    u0, v0, z0 = start
    new, new_wanted = 0, 0
    for n in range(len(directions)):
        if not ranges[n] > 0.0:  # too near, or lost
            continue
        t_end = min(np.float64(ranges[n]), range_max)
        slope = (directions[n, 0] / SEEN_CELL, directions[n, 1] / SEEN_CELL, directions[n, 2])
        cells, cells_wanted = _mark_beam(ceiling, highest, wanted, (u0, v0, z0), slope, t_end)
        new += cells
        new_wanted += cells_wanted
    return new, new_wanted


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _mark_beam(
    ceiling: Float32Array,
    highest: Float32Array,
    wanted: BoolArray,
    start: tuple[float, float, float],
    slope: tuple[float, float, float],
    t_end: float,
) -> tuple[int, int]:
    rows, cols = ceiling.shape
    (u0, v0, z0), (du, dv, dz) = start, slope
    per_u, per_v = inverse(du), inverse(dv)
    far_u, far_v = 0.0 if per_u != 0.0 else FAR, 0.0 if per_v != 0.0 else FAR
    east, north = 1 if du > 0.0 else 0, 1 if dv > 0.0 else 0
    step_u, step_v = 2 * east - 1, 2 * north - 1
    i, j, t = math.floor(u0), math.floor(v0), 0.0
    new, new_wanted = 0, 0
    while t < t_end and 0 <= i < cols and 0 <= j < rows:
        c, r = i >> LEVEL, j >> LEVEL
        block_u = (BLOCK * (c + east) - u0) * per_u + far_u
        block_v = (BLOCK * (r + north) - v0) * per_v + far_v
        leave = min(block_u, block_v, t_end)
        if z0 + (leave if dz < 0.0 else t) * dz <= highest[np.uint64(r), np.uint64(c)]:
            top, stale = highest[np.uint64(r), np.uint64(c)], False
            z, half = z0 + 0.5 * t * dz, 0.5 * dz
            while t < leave and i < cols and j < rows:
                tu, tv = (i + east - u0) * per_u + far_u, (j + north - v0) * per_v + far_v
                t_out = min(tu, tv, leave)
                row, col = np.uint64(j), np.uint64(i)
                if z + half * t_out <= ceiling[row, col]:
                    stale = stale or ceiling[row, col] == top
                    ceiling[row, col] = DONE
                    new += 1
                    new_wanted += wanted[row, col]
                # Without a branch: which side a beam leaves a cell by cannot be foretold.
                i += step_u if tu <= tv else 0
                j += 0 if tu <= tv else step_v
                t = t_out
                z = z0 + half * t
            if stale:
                highest[r, c] = _highest(ceiling, r, c)
        t = max(t, leave)
        across = block_u <= block_v
        at_u = min(max(math.floor(u0 + t * du), BLOCK * c), BLOCK * c + BLOCK - 1)
        at_v = min(max(math.floor(v0 + t * dv), BLOCK * r), BLOCK * r + BLOCK - 1)
        i = BLOCK * (c + east) + east - 1 if across else at_u
        j = at_v if across else BLOCK * (r + north) + north - 1
    return new, new_wanted


@njit(cache=True, nogil=True)
def _highest(ceiling: Float32Array, r: int, c: int) -> np.float32:
    top: np.float32 = DONE
    for j in range(BLOCK * r, min(BLOCK * (r + 1), ceiling.shape[0])):
        for i in range(BLOCK * c, min(BLOCK * (c + 1), ceiling.shape[1])):
            top = max(top, ceiling[j, i])
    return top


@njit(cache=True)
def _highest_of_blocks(ceiling: Float32Array) -> Float32Array:
    rows, cols = -(-ceiling.shape[0] // BLOCK), -(-ceiling.shape[1] // BLOCK)
    highest = np.empty((rows, cols), np.float32)
    for r in range(rows):
        for c in range(cols):
            highest[r, c] = _highest(ceiling, r, c)
    return highest


@njit(cache=True, nogil=True)
def _crop(
    ceiling: Float32Array,
    ground: BoolArray,
    corner: tuple[float, float],
    pose: tuple[float, float, float],
    out: ByteArray,
) -> None:
    rows, cols = ceiling.shape
    n = len(out)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for r in range(n):
        ahead = ((n - 1) / 2 - r) * SEEN_CELL
        for c in range(n):
            left = ((n - 1) / 2 - c) * SEEN_CELL
            i = math.floor((pose[0] + cos * ahead - sin * left - corner[0]) / SEEN_CELL)
            j = math.floor((pose[1] + sin * ahead + cos * left - corner[1]) / SEEN_CELL)
            inside = 0 <= i < cols and 0 <= j < rows
            out[r, c] = 255 if inside and ground[j, i] and ceiling[j, i] == -np.inf else 0
