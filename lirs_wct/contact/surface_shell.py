"""The surface of a closed body as thin convex parts: one for each triangle, as deep as the body lets it be.

What touches the body touches its very triangles. A part is the hull of its triangle and of the same triangle
moved inward along the normals of its corners, which neighbors share: there are no gaps between parts.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray, Int32Array
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.kernels import njit

DEPTH = 0.1
"""Meters that a part reaches inward: contacts push out the shorter way, at 3 m/s one goes 1 to 2 cm deep."""
SHARE = 0.45
"""Of the body's thickness at a corner that a part reaches inward, at most: two sides do not meet."""
LEAST_AREA = 1e-10
"""Square meters below which a triangle is nothing that is touched."""
GRAZING = 0.2
"""Cosine of the angle between a corner's normal and a triangle's below which the triangle takes its own."""


def shell_parts(body: TriangleMesh) -> Iterator[FloatArray]:
    """Yield (6, 3) the corners of each part of a closed body whose faces look outward."""
    normals = body.face_normals
    corner = _corner_normals(body, normals)
    size = float(np.ptp(body.bounds, axis=0).max())
    thickness = _thickness(body.vertices, body.faces, corner, 1e-6 * size)
    depth = np.minimum(DEPTH, SHARE * thickness)
    for triangle, normal in zip(body.faces, normals, strict=True):
        outer = body.vertices[triangle]
        area = np.linalg.norm(np.cross(outer[1] - outer[0], outer[2] - outer[0])) / 2
        if area < LEAST_AREA:
            continue
        inward = np.where((corner[triangle] @ normal > GRAZING)[:, None], corner[triangle], normal)
        yield np.concatenate((outer, outer - depth[triangle, None] * inward))


def touching_volume(body: TriangleMesh, points: FloatArray) -> BoolArray:
    """Return (n,) whether points (n, 3) are inside closed bodies, which may overlap."""
    inside: BoolArray = _winding(body.vertices, body.faces, points) > 0
    return inside


def _corner_normals(body: TriangleMesh, normals: FloatArray) -> FloatArray:
    """Return (n, 3) unit normals of the vertices: those of their faces, weighted by their angles there."""
    total = np.zeros_like(body.vertices)
    for k in range(3):
        here, left, right = (body.vertices[body.faces[:, (k + j) % 3]] for j in range(3))
        a, b = left - here, right - here
        lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        cosine = np.divide((a * b).sum(axis=1), lengths, out=np.ones(len(a)), where=lengths > 0)
        np.add.at(total, body.faces[:, k], np.arccos(np.clip(cosine, -1, 1))[:, None] * normals)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit: FloatArray = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return unit


@njit(cache=True)
def _thickness(vertices: FloatArray, faces: Int32Array, normals: FloatArray, least: float) -> FloatArray:
    """Return (n,) how far each vertex's inward normal goes to the next face (Moeller and Trumbore 1997)."""
    found = np.full(len(vertices), np.inf)
    for f in range(len(faces)):
        i, j, k = faces[f]
        ax, ay, az = vertices[i]
        ex, ey, ez = vertices[j] - vertices[i]
        gx, gy, gz = vertices[k] - vertices[i]
        nx, ny, nz = ey * gz - ez * gy, ez * gx - ex * gz, ex * gy - ey * gx
        for v in range(len(vertices)):
            dx, dy, dz = -normals[v, 0], -normals[v, 1], -normals[v, 2]
            det = -(dx * nx + dy * ny + dz * nz)
            sx, sy, sz = vertices[v, 0] - ax, vertices[v, 1] - ay, vertices[v, 2] - az
            if abs(det) < 1e-15 or v in (i, j, k):
                continue
            t = (sx * nx + sy * ny + sz * nz) / det
            if not least < t < found[v]:
                continue
            # d x s, whose products with the edges are the barycentric coordinates.
            mx, my, mz = dy * sz - dz * sy, dz * sx - dx * sz, dx * sy - dy * sx
            u = -(gx * mx + gy * my + gz * mz) / det
            w = (ex * mx + ey * my + ez * mz) / det
            if u >= -1e-9 and w >= -1e-9 and u + w <= 1 + 1e-9:
                found[v] = t
    return found


@njit(cache=True)
def _winding(vertices: FloatArray, faces: Int32Array, points: FloatArray) -> Int32Array:
    """Return (n,) in how many bodies each point is: tops above it less bottoms above it."""
    count = np.zeros(len(points), np.int32)
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        for n in range(len(points)):
            x, y, z = points[n]
            u = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
            w = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
            # Half-open, so that a point over an edge meets one of its two triangles.
            if u >= 0.0 and w >= 0.0 and u + w < 1.0 and a[2] + w * (b[2] - a[2]) + u * (c[2] - a[2]) > z:
                count[n] += 1 if area > 0 else -1
    return count
