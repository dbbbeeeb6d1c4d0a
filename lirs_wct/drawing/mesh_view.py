"""Oblique view of a mesh, drawn with a depth buffer, without OpenGL."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray, Int32Array
from lirs_wct.drawing.canvas import height_colors
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.kernels import njit

TURN, TILT = math.radians(-28), math.radians(35)
"""Azimuth of the viewer, south and slightly west, and angle by which the viewer looks down, radians."""
LIGHT = np.array((-0.62, -0.34, 0.71))
"""Unit vector towards the light, which comes from the viewer's left."""
TINTS = 256
MOST_ROWS = 1600
"""Limit of a picture's height, pixels; the picture of a taller mesh is narrower."""


class Tints(NamedTuple):
    """Colors of a mesh: (n, 3) `table`, and the row of the table of each vertex."""

    table: FloatArray
    rows: FloatArray


def mesh_view(
    mesh: TriangleMesh, tints: Tints | None = None, *, tilt: float = TILT, width: int = 1100
) -> FloatArray:
    """Return a (rows, <= width, 4) orthographic view in true proportions, transparent outside.

    Args:
        mesh: drawn mesh.
        tints: its colors; None = those of terrain, by height.
        tilt: angle by which the viewer looks down, radians.
        width: largest width of the picture, pixels.
    """
    x, y = (mesh.vertices[:, :2] - mesh.bounds[:, :2].mean(axis=0)).T
    z, c, s = mesh.vertices[:, 2], math.cos(TURN), math.sin(TURN)
    right, depth = c * x + s * y, c * y - s * x
    up, away = depth * math.sin(tilt) + z * math.cos(tilt), depth * math.cos(tilt) - z * math.sin(tilt)
    unit = max(float(np.ptp(right)) / (width - 1), float(np.ptp(up)) / MOST_ROWS)
    points = np.column_stack(((right - right.min()) / unit, (up.max() - up) / unit, away))
    cols, rows = (math.ceil(float(points[:, k].max())) + 1 for k in (0, 1))
    table, row = tints or _by_height(mesh)
    light = 0.5 + 0.55 * np.clip(mesh.face_normals @ LIGHT, 0, 1)
    picture = np.zeros((rows, cols, 4))
    _draw(picture, np.full((rows, cols), np.inf), np.column_stack((points, row)), mesh.faces, light, table)
    return np.clip(picture, 0, 1)


def _by_height(mesh: TriangleMesh) -> Tints:
    (_, _, low), (_, _, high) = mesh.bounds
    rows = (mesh.vertices[:, 2] - low) / max(high - low, 1e-9) * (TINTS - 1)
    return Tints(height_colors()(np.linspace(0, 1, TINTS))[:, :3], rows)


@njit(cache=True)
def _draw(
    picture: FloatArray,
    nearest: FloatArray,
    points: FloatArray,
    faces: Int32Array,
    light: FloatArray,
    table: FloatArray,
) -> None:
    """Paint the pixels where each triangle is nearer than the earlier ones.

    Points are column, row, depth and row of the color table; `light` has one value per triangle.
    """
    rows, cols = nearest.shape
    for k in range(len(faces)):
        ax, ay, az, at = points[faces[k, 0]]
        bx, by, bz, bt = points[faces[k, 1]]
        cx, cy, cz, ct = points[faces[k, 2]]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        for row in range(max(0, math.ceil(min(ay, by, cy))), min(rows - 1, math.floor(max(ay, by, cy))) + 1):
            first, last = math.ceil(min(ax, bx, cx)), math.floor(max(ax, bx, cx))
            for col in range(max(0, first), min(cols - 1, last) + 1):
                b = ((col - ax) * (cy - ay) - (row - ay) * (cx - ax)) / area
                c = ((bx - ax) * (row - ay) - (by - ay) * (col - ax)) / area
                if b < 0 or c < 0 or b + c > 1:
                    continue
                depth = az + b * (bz - az) + c * (cz - az)
                if depth < nearest[row, col]:
                    nearest[row, col] = depth
                    tint = int(at + b * (bt - at) + c * (ct - at))
                    picture[row, col, :3] = table[tint] * light[k]
                    picture[row, col, 3] = 1.0
