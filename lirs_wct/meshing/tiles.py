"""Crack-free tiles of a mesh for consumers that limit the size of a mesh.

Neighbors have bit-equal vertices on their common border.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lirs_wct.arrays import Int32Array
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.kernels import njit

MUJOCO_FACES = 200_000
"""MuJoCo refuses a mesh file with more triangles."""


def split_tiles(mesh: TriangleMesh, *, aim: int, most: int = MUJOCO_FACES) -> Iterator[TriangleMesh]:
    """Yield tiles of a mesh, squares of the ground plan.

    Args:
        mesh: mesh to cut.
        aim: approximate triangles per tile.
        most: largest number of triangles per tile.
    """
    seen = np.full(len(mesh.vertices), -1, dtype=np.int32)
    tile, count = _squares(mesh, aim)
    order = np.argsort(tile, kind="stable").astype(np.int32)
    ends = np.cumsum(np.bincount(tile, minlength=count))
    for start, end in zip(np.concatenate(([0], ends[:-1])), ends, strict=True):
        for i in range(start, end, most):
            faces, used = _renumber(mesh.faces, order[i : min(i + most, end)], seen)
            yield TriangleMesh(
                mesh.vertices[used],
                faces,
                None if mesh.uv is None else mesh.uv[used],
                None if mesh.normals is None else mesh.normals[used],
            )


def _squares(mesh: TriangleMesh, aim: int) -> tuple[Int32Array, int]:
    """Return the square of each face's first vertex, and the number of squares."""
    side = max(1, round((len(mesh.faces) / aim) ** 0.5))
    square = np.zeros(len(mesh.faces), dtype=np.int32)
    if side == 1:
        return square, 1
    first = mesh.faces[:, 0]
    for axis in (0, 1):
        x = mesh.vertices[:, axis]
        low, extent = x.min(), max(float(np.ptp(x)), 1e-9)
        step = ((x[first] - low) * (side / extent)).astype(np.int32)
        square = square * side + np.minimum(step, side - 1)
    return square, side * side


@njit
def _renumber(faces: Int32Array, chosen: Int32Array, seen: Int32Array) -> tuple[Int32Array, Int32Array]:
    """Number the vertices of the chosen faces in order; `seen` is all -1 before and after."""
    out = np.empty((len(chosen), 3), np.int32)
    used = np.empty(3 * len(chosen), np.int32)
    n = 0
    for i in range(len(chosen)):
        for k in range(3):
            v = faces[chosen[i], k]
            if seen[v] < 0:
                seen[v] = n
                used[n] = v
                n += 1
            out[i, k] = seen[v]
    for j in range(n):
        seen[used[j]] = -1
    return out, used[:n].copy()
