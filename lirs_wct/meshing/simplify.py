"""Solids of height fields with fewer triangles: a triangulated irregular network (TIN) within an error."""

from __future__ import annotations

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField, Int32Array
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.solid import base_height, close_solid, node_axes
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
