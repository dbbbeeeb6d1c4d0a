"""Closed solids of a height field: surface in full or simplified, skirt, flat base."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import FloatArray, HeightField, Int32Array
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.tin import (
    BORDER,
    FULL,
    POINTS,
    SHIFT,
    STRIDE,
    TRIANGLES,
    WORST,
    Tin,
    align_diagonals,
    refine,
)

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


LEAST_FACES = 14
"""Two triangles, four skirts of two, a base of four."""
_FIRST_SIZE = 1 << 16
"""Initial capacity, triangles."""
_ROUNDING = 1e-6
"""Share of the budget reserved for rounding, and share of the relief below which an error is rounding."""


def simplified_solid(
    surface: HeightField, *, max_error: float | None = None, max_triangles: int | None = None
) -> TriangleMesh:
    """Return a closed mesh whose top deviates vertically by at most `max_error` anywhere.

    Unlike a decimated grid, it is fine where the ground is rough and coarse where it is flat. The ground
    between pixels is that of `HeightField`, whose cells have MuJoCo's diagonals. The border stays on straight
    edges; skirt and base equal those of `solid_mesh`. With a limit of the whole solid's triangles instead,
    the error is as small as they allow.
    """
    if (max_error is None) == (max_triangles is None):
        raise ConfigError("give one of the options max-error, max-triangles")
    if max_error is not None and not 0 < max_error < float("inf"):
        raise ConfigError(f"max error must be a finite number above 0 m, got {max_error}")
    if max_triangles is not None and max_triangles < LEAST_FACES:
        raise ConfigError(
            f"max triangles must be at least {LEAST_FACES}, a box has as many, got {max_triangles}"
        )
    if max_error is not None:
        max_error = max(max_error - _file_rounding(surface), max_error / 2)
    points, faces = triangulate(surface, max_error=max_error, max_triangles=max_triangles)
    (x, y), (row, col) = node_axes(surface), points.T
    south, east = surface.shape[0] - 1, surface.shape[1] - 1
    border = []
    for on_side, along in ((col == 0, row), (row == south, col), (col == east, -row), (row == 0, -col)):
        side = np.flatnonzero(on_side)
        # The last one is the first of the next side.
        border.append(side[np.argsort(along[side])][:-1])
    vertices = np.column_stack((x[col], y[row], surface.z[row, col].astype(np.float64)))
    return close_solid(vertices, faces, np.concatenate(border).astype(np.int32), base_height(surface))


def _file_rounding(surface: HeightField) -> float:
    """Return the vertical error of float32 mesh files on the steepest ground, meters."""
    step = float(np.spacing(np.float32(max(map(abs, surface.bounds)))))
    slopes = (
        float(np.abs(np.diff(surface.z, axis=axis)).max()) / cell
        for axis, cell in ((1, surface.cell[0]), (0, surface.cell[1]))
    )
    # Half a rounding step along each horizontal axis, and half a step of height.
    return sum(slopes) * step / 2 + float(np.spacing(np.float32(np.abs(surface.z).max()))) / 2


def triangulate(
    surface: HeightField, *, max_error: float | None = None, max_triangles: int | None = None
) -> tuple[Int32Array, Int32Array]:
    """Choose pixels within one budget and triangulate them (Garland and Heckbert 1995; kernels in `tin`).

    Returns row and column (n, 2) of the pixels, and faces (m, 3), counter-clockwise from above.
    """
    floor = surface.relief * _ROUNDING
    budget = floor if max_error is None else max(max_error * (1 - _ROUNDING), floor)
    most = np.iinfo(np.int64).max if max_triangles is None else max_triangles
    z, cols = surface.z.ravel(), surface.shape[1]
    low, high = (np.float64(error).view(np.int64) >> SHIFT for error in (budget, max(budget, surface.relief)))
    tin = _two_triangles(*surface.shape, int(high - low) + 1)
    while refine(tin, z, cols, budget, most) == FULL:
        larger = _empty(2 * len(tin.fan))._replace(bins=tin.bins, taken=tin.taken, used=tin.used)
        for part in (0, 1, 2):  # point, link and queue
            larger[part][: len(tin[part])] = tin[part]
        tin = larger
    points, triangles = int(tin.used[POINTS]), int(tin.used[TRIANGLES])
    align_diagonals(tin)
    return tin.point[:points].copy(), tin.link.reshape(-1, STRIDE)[:triangles, :3].copy()


def _two_triangles(rows: int, cols: int, bins: int) -> Tin:
    tin = _empty(_FIRST_SIZE)._replace(
        bins=np.full(bins, -1, np.int32), taken=np.zeros(rows * cols, np.bool_)
    )
    south, east = rows - 1, cols - 1
    tin.point[:4] = (0, 0), (0, east), (south, 0), (south, east)
    nw, ne, sw, se = range(4)
    triangles = tin.link.reshape(-1, STRIDE)
    # They share the diagonal: edge 1 of the first, edge 2 of the second.
    triangles[0, :WORST] = nw, sw, ne, -1, STRIDE + 2, -1
    triangles[1, :WORST] = sw, se, ne, -1, -1, 1
    tin.used[[POINTS, TRIANGLES, BORDER]] = 4, 2, 4
    tin.taken[[0, east, south * cols, south * cols + east]] = True
    return tin


def _empty(triangles: int) -> Tin:
    t = triangles
    return Tin(
        point=np.empty((t, 2), np.int32),
        link=np.empty(STRIDE * t, np.int32),
        queue=np.empty(2 * t, np.int32),
        bins=np.empty(0, np.int32),
        taken=np.empty(0, np.bool_),
        fan=np.empty(t, np.int32),
        rim=np.empty(2 * t + 1, np.int32),
        stack=np.empty(t + 3, np.int32),
        used=np.zeros(4, np.int64),
    )
