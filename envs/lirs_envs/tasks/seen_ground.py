"""Ground seen by lidars: one grid for each of N robots."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.lidar.lidar import transform_rays
from lirs_envs.lidar.terrain_rays import FAR_DISTANCE, FUSED, inverse
from lirs_envs.tasks.site import SEEN_CELL, SeenFrame
from lirs_wct.arrays import BoolArray, ByteArray, Float32Array, FloatArray, IntArray, njit

DONE = np.float32(-np.inf)
"""Ceiling of a cell that no beam passes below: it has no ground or was already seen."""
LEVEL = 1
BLOCK = 2**LEVEL
"""Cells along the side of a block: the fastest of 2, 4 and 8."""
Grids = tuple[Float32Array, Float32Array, BoolArray]
"""Flat (rows * cols) heights up to which a beam sees a cell's ground, meters; the highest of each block;
and which cells are counted apart."""
Layout = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
"""Along and across a beam: indices between two cells, indices between two blocks, number of cells."""


class SeenGround:
    """Grid of seen cells for each of N robots, from true poses.

    A cell is seen where a beam passed at most `reach` above its ground, or ended on it.

    Attributes:
        cells: (N,) number of seen cells.
        wanted_cells: (N,) number of seen cells among the wanted ones.

    Args:
        shape: rows and columns of the grid.
        beams: (n, 3) directions of the beams in the base's frame, unit vectors.
        mount: (3,) the lidar in the base's frame, meters.
    """

    def __init__(
        self, count: int, shape: tuple[int, int], beams: FloatArray, mount: FloatArray, reach: float
    ) -> None:
        self._beams, self._mount, self._reach = beams, mount[None], reach
        blocks = (count, -(-shape[0] // BLOCK), -(-shape[1] // BLOCK))
        self._ceilings: Float32Array = np.full((count, *shape), DONE)
        self._highest: Float32Array = np.full(blocks, DONE)
        self._ground: BoolArray = np.zeros((count, *shape), np.bool_)
        self._wanted: BoolArray = np.zeros((count, *shape), np.bool_)
        self._corners = np.zeros((count, 2))
        self.cells = np.zeros(count, np.int64)
        self.wanted_cells = np.zeros(count, np.int64)

    def begin(self, i: int, frame: SeenFrame, wanted: BoolArray) -> None:
        """Clear the grid of robot `i`. `wanted` (rows, cols) cells are counted separately."""
        np.add(frame.height, np.float32(self._reach), out=self._ceilings[i])
        np.isfinite(frame.height, out=self._ground[i])
        _bound_blocks(self._ceilings[i], self._highest[i], self._wanted[i])
        self._wanted[i], self._corners[i] = wanted, frame.corner
        self.cells[i] = self.wanted_cells[i] = 0

    def add(self, rows: IntArray, ranges: Float32Array, range_max: float, T_world_base: FloatArray) -> None:
        """Mark the cells below robots' beams as seen; without return, over the full range.

        Ranges are (N, n) meters (see `LaserScan`), poses (N, 7) x, y, z, qw, qx, qy, qz.
        """
        _mark_rows(
            rows,
            (T_world_base, self._corners, self._mount, self._beams),
            ranges,
            range_max,
            (self._ceilings, self._highest, self._wanted),
            self.cells,
            self.wanted_cells,
        )

    def seen(self, i: int) -> BoolArray:
        """Return (rows, cols) the cells that robot `i` has seen, row 0 = south."""
        seen: BoolArray = self._ground[i] & (self._ceilings[i] == DONE)
        return seen

    def local_map(self, i: int, x: float, y: float, yaw: float, out: ByteArray) -> None:
        """Fill the local map (n, n) around the robot, 255 = seen. Row 0 = ahead, column 0 = left."""
        corner = float(self._corners[i, 0]), float(self._corners[i, 1])
        _crop(self._ceilings[i], self._ground[i], corner, (x, y, yaw), out)


@njit
def _mark_rows(
    rows: IntArray,
    fans: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    ranges: Float32Array,
    range_max: float,
    grids: tuple[Float32Array, Float32Array, BoolArray],
    cells: IntArray,
    wanted_cells: IntArray,
) -> None:
    T_world_base, corners, mount, beams = fans
    ceilings, highest, wanted = grids
    origin, directions = np.empty((1, 3)), np.empty_like(beams)
    for i in rows:
        T = T_world_base[i]
        transform_rays((T[3], T[4], T[5], T[6]), (T[0], T[1], T[2]), mount, beams, origin, directions)
        start = (
            (origin[0, 0] - corners[i, 0]) / SEEN_CELL,
            (origin[0, 1] - corners[i, 1]) / SEEN_CELL,
            origin[0, 2],
        )
        new, new_wanted = mark_seen(
            ceilings[i], highest[i], wanted[i], start, directions, ranges[i], range_max
        )
        cells[i] += new
        wanted_cells[i] += new_wanted


@njit(fastmath=FUSED)
def mark_seen(
    ceiling: Float32Array,
    highest: Float32Array,
    wanted: BoolArray,
    start: tuple[float, float, float],
    directions: FloatArray,
    ranges: Float32Array,
    range_max: float,
) -> tuple[int, int]:
    """Mark the cells below beams (n, 3) as seen; count new and wanted cells.

    Cells are those that a beam crosses in the plane; its height is that in the middle of the crossing. A
    cell's ceiling is the height up to which a beam sees its ground, -inf once it is seen; `highest` is that
    of each block of cells. The start is u and v in cells from the grid's corner, and z in meters.
    """
    (rows, cols), width = ceiling.shape, highest.shape[1]
    u, v, z = start
    new, new_wanted = 0, 0
    if not (0.0 <= u < cols and 0.0 <= v < rows):
        return new, new_wanted
    grids = (ceiling.reshape(-1), highest.reshape(-1), wanted.reshape(-1))
    near = np.empty(max(highest.shape), np.int64)
    for n in range(len(directions)):
        if not ranges[n] > 0.0:  # too near, or lost
            continue
        t_end = min(np.float64(ranges[n]), range_max)
        du, dv, dz = directions[n, 0] / SEEN_CELL, directions[n, 1] / SEEN_CELL, directions[n, 2]
        if abs(du) >= abs(dv):
            one, two = _mark_beam(
                grids, ((1, cols), (1, width), (cols, rows)), (u, v, z), (du, dv, dz), t_end, near
            )
        else:
            one, two = _mark_beam(
                grids, ((cols, 1), (width, 1), (rows, cols)), (v, u, z), (dv, du, dz), t_end, near
            )
        new += one
        new_wanted += two
    return new, new_wanted


@njit(fastmath=FUSED, forceinline=True)
def _mark_beam(
    grids: Grids,
    layout: Layout,
    start: tuple[float, float, float],
    slope: tuple[float, float, float],
    t_end: float,
    near: IntArray,
) -> tuple[int, int]:
    """Mark the cells of a beam, column by column along its main axis.

    It crosses at most two cells of a column, and no column waits for the one before. First the columns of
    blocks in which it comes below a ceiling are put in `near`, without a branch that cannot be foretold.
    In one piece: a call within would count references to the grids, which doubles the time.
    """
    ceiling, highest, wanted = grids
    (along, across), (block_along, block_across), (length, breadth) = layout
    (p, q, z), (dp, dq, dz) = start, slope
    per_p, per_q, ahead = inverse(dp), inverse(dq), 1 if dp > 0.0 else 0
    far, t_end = 0.0 if per_p != 0.0 else FAR_DISTANCE, _clip_beam(p, q, dp, dq, length, breadth, t_end)
    first, last, step = int(p), min(max(int(p + dp * t_end), 0), length - 1), 2 * ahead - 1
    first_block, last_block = first >> LEVEL, last >> LEVEL
    count, t, row = 0, 0.0, int(q) >> LEVEL
    for k in range(abs(last_block - first_block) + 1):
        block = first_block + step * k
        t_out = min((BLOCK * (block + ahead) - p) * per_p + far, t_end)
        row_out = min(max(int(q + dq * t_out), 0), breadth - 1) >> LEVEL
        one = highest[np.uint64(block_along * block + block_across * row)]
        two = highest[np.uint64(block_along * block + block_across * row_out)]
        near[np.uint64(count)] = block
        count += 1 if z + dz * (t_out if dz < 0.0 else t) <= max(one, two) else 0
        t, row = t_out, row_out
    new, new_wanted = 0, 0
    for m in range(count):
        block, before = near[np.uint64(m)], new
        begin = first if block == first_block else BLOCK * block + (1 - ahead) * (BLOCK - 1)
        end = last if block == last_block else BLOCK * block + ahead * (BLOCK - 1)
        t = max((begin + 1 - ahead - p) * per_p, 0.0)
        row = entry = min(max(int(q + dq * t), 0), breadth - 1)
        for k in range(abs(end - begin) + 1):
            column = begin + step * k
            t_out = min((column + ahead - p) * per_p + far, t_end)
            row_out = min(max(int(q + dq * t_out), 0), breadth - 1)
            t_side = t_out if row == row_out else (max(row, row_out) - q) * per_q
            here, beside = along * column + across * row, along * column + across * row_out
            height = z + 0.5 * dz * (t + t_side)
            if height <= ceiling[np.uint64(here)]:
                ceiling[np.uint64(here)] = DONE
                new, new_wanted = new + 1, new_wanted + wanted[np.uint64(here)]
            if (height if row == row_out else z + 0.5 * dz * (t_side + t_out)) <= ceiling[np.uint64(beside)]:
                ceiling[np.uint64(beside)] = DONE
                new, new_wanted = new + 1, new_wanted + wanted[np.uint64(beside)]
            t, row = t_out, row_out
        if new > before:
            _bound_block(grids, layout, block, entry >> LEVEL)
            _bound_block(grids, layout, block, row >> LEVEL)
    return new, new_wanted


@njit(fastmath=FUSED, forceinline=True)
def _clip_beam(p: float, q: float, dp: float, dq: float, length: int, breadth: int, t_end: float) -> float:
    """Return the end of a beam within the grid."""
    per_p, per_q = inverse(dp), inverse(dq)
    t_end = min(
        t_end, (length * (1 if dp > 0.0 else 0) - p) * per_p + (0.0 if per_p != 0.0 else FAR_DISTANCE)
    )
    if per_q != 0.0:
        t_end = min(t_end, ((breadth if dq > 0.0 else 0) - q) * per_q)
    return t_end


@njit
def _bound_block(grids: Grids, layout: Layout, block: int, row: int) -> None:
    """Set the highest ceiling of a block, given along and across a beam."""
    ceiling, highest, _ = grids
    cells, blocks, (length, breadth) = layout
    top = DONE
    for i in range(BLOCK * block, min(BLOCK * (block + 1), length)):
        for j in range(BLOCK * row, min(BLOCK * (row + 1), breadth)):
            top = max(top, ceiling[cells[0] * i + cells[1] * j])
    highest[blocks[0] * block + blocks[1] * row] = top


@njit
def _bound_blocks(ceiling: Float32Array, highest: Float32Array, wanted: BoolArray) -> None:
    (rows, cols), (high, wide) = ceiling.shape, highest.shape
    grids = (ceiling.reshape(-1), highest.reshape(-1), wanted.reshape(-1))
    for r in range(high):
        for c in range(wide):
            _bound_block(grids, ((1, cols), (1, wide), (cols, rows)), c, r)


@njit
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
