"""Bounds of a height field over squares of cells: the hierarchy that lets a ray skip empty space.

After Tevs, Ihrke, Seidel 2008, "Maximum mipmaps for fast, accurate, and scalable dynamic height field
rendering": level k bounds squares of 2^k x 2^k cells. A ray above the surface asks for the maximum
alone, a ray below it for the minimum alone, so that the two lie apart.

The finest level has squares of 8x8 cells, blocks whose nodes lie side by side in memory: a ray that goes
through a block touches few cache lines, where rows of the whole field would lie on a page each.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import Float32Array, FloatArray, IntArray
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.kernels import njit

LEAF = 3
"""Level of the blocks, which hold 2^LEAF x 2^LEAF cells."""
EDGE = 2**LEAF
"""Cells along a block's side."""
ROW = EDGE + 1
"""Nodes along a block's side; neighbors hold the nodes between them both."""


class TerrainMipmap(NamedTuple):
    """A height field as the kernels read it; row 0 = south.

    Attributes:
        block: (blocks, ROW * ROW) float32 heights of each block's nodes, row by row, meters; beyond the
            field's edge its last node again.
        bound: flat float32: for levels LEAF, LEAF + 1, ... one after the other the highest z over each
            square; then once more the highest of -z, so that one comparison serves both sides.
        start: (levels + 1,) index of each level's first square; entries below LEAF are unused.
        width: (levels + 1,) squares a row of each level; entries below LEAF are unused.
        frame: (7,) x and y of the south-west node, cell x and y, lowest and highest z, margin; meters.
        cells: columns and rows.
    """

    block: Float32Array
    bound: Float32Array
    start: IntArray
    width: IntArray
    frame: FloatArray
    cells: tuple[int, int]


def build_terrain_mipmap(surface: HeightField) -> TerrainMipmap:
    """Build blocks and bounds of a height field: one pass over the nodes and little for the levels."""
    z = surface.south_up
    ny, nx = z.shape[0] - 1, z.shape[1] - 1
    shapes = _level_shapes(ny, nx)
    ends = np.cumsum([rows * cols for rows, cols in shapes])
    bound = np.empty((2, ends[-1]), np.float32)
    levels = [
        bound[:, end - rows * cols : end].reshape(2, rows, cols)
        for (rows, cols), end in zip(shapes, ends, strict=True)
    ]
    block = np.empty((*shapes[0], ROW * ROW), np.float32)
    _fill_blocks(z, block, levels[0])
    for fine, coarse in pairwise(levels):
        _bound_squares(fine, coarse)
    unused = (0,) * LEAF
    start = np.array((*unused, 0, *ends[:-1]), dtype=np.int64)
    width = np.array((*unused, *(cols for _, cols in shapes)), dtype=np.int64)
    low, high = float(z.min()), float(z.max())
    # A ray enters the slab of heights this far from the surface, so that rounding cannot put it on the
    # wrong side there.
    margin = 1e-3 + 0.01 * (high - low) + 1e-6 * max(abs(low), abs(high))
    frame = np.array((*surface.origin, *surface.cell, low, high, margin), dtype=np.float64)
    return TerrainMipmap(block.reshape(-1, ROW * ROW), bound.ravel(), start, width, frame, (nx, ny))


def _level_shapes(rows: int, cols: int) -> list[tuple[int, int]]:
    """Return rows and columns of squares of level LEAF, LEAF + 1, ... up to the one with a single square."""
    shapes = [(-(-rows // EDGE), -(-cols // EDGE))]
    while max(shapes[-1]) > 1:
        rows, cols = shapes[-1]
        shapes.append(((rows + 1) // 2, (cols + 1) // 2))
    return shapes


@njit(cache=True)
def _fill_blocks(z: Float32Array, block: Float32Array, bound: Float32Array) -> None:
    """Fill the blocks (rows, cols, ROW * ROW) and the finest level (2, rows, cols)."""
    last_row, last_col = z.shape[0] - 1, z.shape[1] - 1
    for r in range(block.shape[0]):
        for c in range(block.shape[1]):
            high = low = z[EDGE * r, EDGE * c]
            for i in range(ROW):
                for j in range(ROW):
                    height = z[min(EDGE * r + i, last_row), min(EDGE * c + j, last_col)]
                    block[r, c, ROW * i + j] = height
                    high, low = max(high, height), min(low, height)
            bound[0, r, c] = high
            bound[1, r, c] = -low


@njit(cache=True)
def _bound_squares(fine: Float32Array, coarse: Float32Array) -> None:
    """Fill a level (2, rows, cols) from the one below it."""
    for s in range(2):
        for r in range(coarse.shape[1]):
            for c in range(coarse.shape[2]):
                high = fine[s, 2 * r, 2 * c]
                for i in range(2 * r, min(2 * r + 2, fine.shape[1])):
                    for j in range(2 * c, min(2 * c + 2, fine.shape[2])):
                        high = max(high, fine[s, i, j])
                coarse[s, r, c] = high
