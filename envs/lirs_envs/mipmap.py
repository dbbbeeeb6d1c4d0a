"""Bounds of a height field over squares of cells: the hierarchy that lets a ray skip empty space.

After Tevs, Ihrke, Seidel 2008, "Maximum mipmaps for fast, accurate, and scalable dynamic height field
rendering": level k bounds squares of 2^k x 2^k cells. A ray above the surface asks for the maximum
alone, a ray below it for the minimum alone, so that the two lie apart.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lirs_wct.heightfield import HeightField

Floats = NDArray[np.float32]


class Terrain(NamedTuple):
    """A height field as the kernels read it; row 0 = south.

    Attributes:
        z: (rows, cols) float32 heights of the nodes, metres.
        bound: flat float32: for levels 1, 2, ... one after the other the highest z over each square; then
            once more the highest of -z, so that one comparison serves both sides.
        start: (levels + 1,) index of each level's first square; entry 0 is unused (cells read z).
        width: (levels + 1,) squares a row of each level; entry 0 is unused.
        frame: (7,) x and y of the south-west node, cell x and y, lowest and highest z, margin; metres.
    """

    z: Floats
    bound: Floats
    start: NDArray[np.int64]
    width: NDArray[np.int64]
    frame: NDArray[np.float64]


def terrain_of(surface: HeightField) -> Terrain:
    """Build the bounds of a height field: one pass over the nodes and a third as much for the levels."""
    z = surface.south_up
    shapes = _level_shapes(z.shape[0] - 1, z.shape[1] - 1)
    ends = np.cumsum([rows * cols for rows, cols in shapes])
    bound = np.empty((2, ends[-1]), np.float32)
    levels = [
        bound[:, end - rows * cols : end].reshape(2, rows, cols)
        for (rows, cols), end in zip(shapes, ends, strict=True)
    ]
    _bound_nodes(z, levels[0])
    for fine, coarse in pairwise(levels):
        _bound_squares(fine, coarse)
    start = np.array((0, 0, *ends[:-1]), dtype=np.int64)
    width = np.array((0, *(cols for _, cols in shapes)), dtype=np.int64)
    low, high = float(z.min()), float(z.max())
    # A ray enters the slab of heights this far from the surface, so that rounding cannot put it on the
    # wrong side there.
    margin = 1e-3 + 0.01 * (high - low) + 1e-6 * max(abs(low), abs(high))
    frame = np.array((*surface.origin, *surface.cell, low, high, margin), dtype=np.float64)
    return Terrain(z, bound.ravel(), start, width, frame)


def _level_shapes(rows: int, cols: int) -> list[tuple[int, int]]:
    """Return rows and columns of squares of level 1, 2, ... up to the one with a single square."""
    shapes = [((rows + 1) // 2, (cols + 1) // 2)]
    while max(shapes[-1]) > 1:
        rows, cols = shapes[-1]
        shapes.append(((rows + 1) // 2, (cols + 1) // 2))
    return shapes


@njit(cache=True)
def _bound_nodes(z: Floats, bound: Floats) -> None:
    """Fill level 1 (2, rows, cols): a square of 2x2 cells has 3x3 nodes, fewer at the north and east edge."""
    for r in range(bound.shape[1]):
        for c in range(bound.shape[2]):
            high = low = z[2 * r, 2 * c]
            for i in range(2 * r, min(2 * r + 3, z.shape[0])):
                for j in range(2 * c, min(2 * c + 3, z.shape[1])):
                    high = max(high, z[i, j])
                    low = min(low, z[i, j])
            bound[0, r, c] = high
            bound[1, r, c] = -low


@njit(cache=True)
def _bound_squares(fine: Floats, coarse: Floats) -> None:
    """Fill a level (2, rows, cols) from the one below it."""
    for s in range(2):
        for r in range(coarse.shape[1]):
            for c in range(coarse.shape[2]):
                high = fine[s, 2 * r, 2 * c]
                for i in range(2 * r, min(2 * r + 2, fine.shape[1])):
                    for j in range(2 * c, min(2 * c + 2, fine.shape[2])):
                        high = max(high, fine[s, i, j])
                coarse[s, r, c] = high
