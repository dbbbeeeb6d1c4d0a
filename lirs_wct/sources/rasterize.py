"""Rasterization of a mesh from above: height of its highest triangle at grid nodes."""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import FloatArray, Int32Array
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.kernels import njit

Grid = tuple[float, float, float, float]
"""x and y of the south-west node, spacing eastward and northward, meters."""
_SLACK = 1e-9
"""Tolerance at a triangle's edges, share of the triangle, so that no node falls between two triangles."""


def rasterize_heights(mesh: TriangleMesh, grid: Grid, shape: tuple[int, int]) -> FloatArray:
    """Return (rows, cols) heights of the mesh's highest point at each node, row 0 = south.

    Exact: each triangle is evaluated at the nodes that it covers. NaN without a triangle.
    """
    top, count = np.full(shape, -np.inf), np.zeros(shape, np.int32)
    _rasterize(np.ascontiguousarray(mesh.vertices), mesh.faces, grid, _SLACK, top, count)
    top[count == 0] = np.nan
    return top


def layers(mesh: TriangleMesh, grid: Grid, shape: tuple[int, int]) -> Int32Array:
    """Return (rows, cols) numbers of triangles on a vertical line through each cell.

    The lines are slightly off the cells' centers, at fractions that edges rarely have.
    """
    count = np.zeros((shape[0] - 1, shape[1] - 1), np.int32)
    beside = (grid[0] + 0.4871203 * grid[2], grid[1] + 0.5132079 * grid[3], grid[2], grid[3])
    _rasterize(
        np.ascontiguousarray(mesh.vertices), mesh.faces, beside, 0.0, np.full(count.shape, -np.inf), count
    )
    return count


@njit
def _rasterize(
    vertices: FloatArray, faces: Int32Array, grid: Grid, slack: float, top: FloatArray, count: Int32Array
) -> None:
    """Raise `top` to each triangle's height at the nodes inside it; count the triangles."""
    rows, cols = top.shape
    x0, y0, cell_x, cell_y = grid
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        # Unit: nodes, relative to the first corner; small numbers keep their digits.
        ax, ay = (vertices[a, 0] - x0) / cell_x, (vertices[a, 1] - y0) / cell_y
        bx, by = (vertices[b, 0] - x0) / cell_x - ax, (vertices[b, 1] - y0) / cell_y - ay
        cx, cy = (vertices[c, 0] - x0) / cell_x - ax, (vertices[c, 1] - y0) / cell_y - ay
        area = bx * cy - by * cx
        if abs(area) <= 1e-12 * (abs(bx * cy) + abs(by * cx)) or area == 0.0:
            continue
        west, east = ax + min(0.0, bx, cx), ax + max(0.0, bx, cx)
        south, north = ay + min(0.0, by, cy), ay + max(0.0, by, cy)
        i0, i1 = max(0, int(np.ceil(west - 1e-9))), min(cols - 1, int(np.floor(east + 1e-9)))
        j0, j1 = max(0, int(np.ceil(south - 1e-9))), min(rows - 1, int(np.floor(north + 1e-9)))
        za, zb, zc = vertices[a, 2], vertices[b, 2], vertices[c, 2]
        for j in range(j0, j1 + 1):
            # Nodes between the edges, and one more: long thin triangles fill little of their box.
            i2, i3 = float(i0), float(i1)
            for step, start in (
                (cy / area, (-ax * cy - (j - ay) * cx) / area),
                (-by / area, (bx * (j - ay) + by * ax) / area),
                ((by - cy) / area, 1 - (bx * (j - ay) + by * ax - ax * cy - (j - ay) * cx) / area),
            ):
                # The weight of a corner is start + step * i, and at least 0 inside.
                if step > 0.0:
                    i2 = max(i2, min(np.floor(-(start + slack) / step) - 1, i1 + 1.0))
                elif step < 0.0:
                    i3 = min(i3, max(np.ceil(-(start + slack) / step) + 1, i0 - 1.0))
            for i in range(int(i2), int(i3) + 1):
                wb = ((i - ax) * cy - (j - ay) * cx) / area
                wc = (bx * (j - ay) - by * (i - ax)) / area
                if wb >= -slack and wc >= -slack and wb + wc <= 1.0 + slack:
                    z = za + wb * (zb - za) + wc * (zc - za)
                    top[j, i] = max(top[j, i], z)
                    count[j, i] += 1
