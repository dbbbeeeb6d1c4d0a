"""Closed solids of a height field: surface, skirt, flat base."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lirs_wct.geometry import FloatArray, HeightField, Int32Array
from lirs_wct.geometry.mesh import TriangleMesh

MIN_THICKNESS = 0.1
"""Smallest thickness below the lowest point, meters: a wheel must not pass through it in one step."""

_BLOCK = 1 << 13
"""Nodes per step of triangle generation."""


def solid_mesh(surface: HeightField) -> TriangleMesh:
    """Return the full grid as a closed mesh: two triangles per cell, skirt, base.

    The order of vertices: the surface's nodes row by row from the north-west, then the base's border. Cells
    are split from south-west to north-east, as in `HeightField`.
    """
    rows, cols = surface.shape
    vertices = np.empty((rows * cols, 3))
    grid = vertices.reshape(rows, cols, 3)
    x, y = node_axes(surface)
    grid[..., 0], grid[..., 1], grid[..., 2] = x, y[:, None], surface.z
    return close_solid(vertices, _grid_faces(rows, cols), _border(rows, cols), base_height(surface))


def solid_triangles(surface: HeightField) -> tuple[int, Iterator[FloatArray]]:
    """Return the number of triangles of `solid_mesh`, and their corners (n, 3, 3).

    It yields a few rows at a time, for surfaces whose mesh would fill the memory.
    """
    (rows, cols), (x, y) = surface.shape, node_axes(surface)

    def parts() -> Iterator[FloatArray]:
        step = max(1, _BLOCK // cols)
        for start in range(0, rows - 1, step):
            part = slice(start, min(start + step, rows - 1) + 1)
            strip = surface.z[part]
            nodes = np.empty((*strip.shape, 3))
            nodes[..., 0], nodes[..., 1], nodes[..., 2] = x, y[part, None], strip
            yield nodes.reshape(-1, 3)[_grid_faces(len(strip), cols)]
        row, col = np.divmod(_border(rows, cols), cols)
        rim = np.column_stack((x[col], y[row], surface.z[row, col].astype(np.float64)))
        border = np.arange(len(rim), dtype=np.int32)
        rest = close_solid(rim, np.empty((0, 3), np.int32), border, base_height(surface))
        yield rest.vertices[rest.faces]

    return 2 * (rows - 1) * (cols - 1) + 6 * (rows + cols - 2), parts()


def base_height(surface: HeightField) -> float:
    """Return z of the base, meters: a tenth of the relief below the ground."""
    return float(surface.z.min()) - max(MIN_THICKNESS, surface.relief / 10)


def node_axes(surface: HeightField) -> tuple[FloatArray, FloatArray]:
    """Return x (cols,) eastward and y (rows,) southward of the nodes, meters."""
    rows, cols = surface.shape
    west, south, east, north = surface.bounds
    # linspace: the border lies exactly on the bounds.
    return np.linspace(west, east, cols), np.linspace(north, south, rows)


def close_solid(vertices: FloatArray, faces: Int32Array, border: Int32Array, z_base: float) -> TriangleMesh:
    """Add a skirt and a base to an open surface over a rectangle.

    The base, at `z_base` meters, is a fan around its center, which the convex outline allows. The border is
    the outline's vertices; it and the faces run counter-clockwise from above.
    """
    n, k = len(vertices), len(border)
    base = vertices[border]
    base[:, 2] = z_base
    center = np.array([[*(base[:, :2].min(axis=0) + base[:, :2].max(axis=0)) / 2, z_base]])
    top, top_next = border, np.roll(border, -1)
    low = np.arange(n, n + k, dtype=np.int32)
    low_next = np.roll(low, -1)
    middle = np.full(k, n + k, dtype=np.int32)
    skirt = np.concatenate(
        (np.stack((top, low, low_next), axis=1), np.stack((top, low_next, top_next), axis=1))
    )
    bottom = np.stack((low_next, low, middle), axis=1)
    return TriangleMesh(np.concatenate((vertices, base, center)), np.concatenate((faces, skirt, bottom)))


def _grid_faces(rows: int, cols: int) -> Int32Array:
    """Return (2 * cells, 3) faces; the two triangles of a cell are adjacent."""
    nw = (np.arange(rows - 1, dtype=np.int32)[:, None] * cols + np.arange(cols - 1, dtype=np.int32)).ravel()
    faces = np.empty((len(nw), 2, 3), dtype=np.int32)
    # nw, sw, ne and sw, se, ne share the diagonal sw-ne.
    for i, offset in enumerate((0, cols, 1)):
        faces[:, 0, i] = nw + offset
    for i, offset in enumerate((cols, cols + 1, 1)):
        faces[:, 1, i] = nw + offset
    return faces.reshape(-1, 3)


def _border(rows: int, cols: int) -> Int32Array:
    """Return the outline's nodes, counter-clockwise from above, from the north-west corner."""
    west = np.arange(0, (rows - 1) * cols, cols, dtype=np.int32)
    south = (rows - 1) * cols + np.arange(cols - 1, dtype=np.int32)
    # The opposite sides, turned round: node i of the whole is the last one's n - i.
    last = np.int32(rows * cols - 1)
    return np.concatenate((west, south, last - west, last - south))
