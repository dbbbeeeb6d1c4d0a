"""Texture projections, with vertex normals for renderers.

The paper's tool maps one texture onto each face of a cube around the model (section III-B). Here the
faces of the cube are unfolded around the upper one, so that the texture continues without a seam from
the terrain over its border down the skirt. A top-view picture is draped instead: projected once from above.
Walls have an upright texture on each side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, FloatArray, Int32Array, IntArray, njit
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.mesh import TriangleMesh

EAST, WEST, NORTH, SOUTH, UP, DOWN = range(6)
FLAT = 6
"""Offset of the label for faces that are vertical or face downward; they have separate normals."""
LABELS = 12
VERTICAL = 1e-9
"""Largest upward share of a vertical face's normal."""
WALL_VERTICAL = 0.1
"""The same on a wall, whose corners may be a millimeter apart."""


def cube_uv(mesh: TriangleMesh, size: float | None = None) -> TriangleMesh:
    """Return the mesh with texture coordinates from the sides of a cube, and vertex normals.

    A vertex is split if its triangles are projected on different sides, or if it lies on the sharp border
    between ground and skirt. The result is closed in space, not in its indices.

    Args:
        mesh: triangles without attributes.
        size: side of one texture, meters; default: the longest edge of the bounding box, so that one texture
            spans each side of the cube.

    Raises:
        ConfigError: size is not above 0.
    """
    bounds = mesh.bounds
    span = float(np.ptp(bounds, axis=0).max()) if size is None else size
    if not 0 < span < float("inf"):
        raise ConfigError(f"texture size must be a finite number above 0 m, got {span}")
    split = _split(mesh)
    # A skirt hangs from its rim; a vertical face of another outline has none.
    on_side = (split.side >= FLAT) & (split.side < FLAT + UP)
    top = split.top if split.hangs[on_side].all() else np.full_like(split.top, bounds[1, 2])
    return split.with_uv(_unfold(split.points, top, split.side, bounds, span))


def draped_uv(
    mesh: TriangleMesh, bounds: tuple[float, float, float, float], margin: float = 0.0
) -> TriangleMesh:
    """Project a picture from above, once; a skirt shows the picture's border.

    Args:
        mesh: triangles without attributes.
        bounds: west, south, east, north of the picture, meters.
        margin: share of the picture omitted along its border: half a pixel for renderers that would mix in
            the opposite border.
    """
    split = _split(mesh, draped=True)
    west, south, east, north = bounds
    uv = (split.points[:, :2] - (west, south)) / (east - west, north - south)
    return split.with_uv(np.clip(uv, margin, 1 - margin))


def wall_uv(mesh: TriangleMesh, size: float) -> TriangleMesh:
    """Project a texture upright on the sides of axis-parallel walls, and flat on their tops.

    The texture starts at z = 0.

    Args:
        mesh: triangles without attributes.
        size: side of one texture, meters.
    """
    split = _split(mesh, vertical=WALL_VERTICAL)
    x, y, z = split.points.T
    # As seen from outside, to the right.
    right = np.select([split.side == FLAT + k for k in (EAST, WEST, NORTH)], [y, -y, -x], x)
    return split.with_uv(np.stack((right, np.where(split.side == UP, y, z)), axis=1) / size)


@dataclass(frozen=True, slots=True)
class _Split:
    """A mesh whose vertices are split by the cube side of their triangles.

    Attributes:
        points: (n, 3) meters.
        faces: (m, 3).
        normals: (n, 3).
        side: (n,) labels of the vertices.
        top: (n,) z of the rim above a vertex of a skirt.
        hangs: (n,) whether a vertical edge of a vertical face ends at the vertex.
    """

    points: FloatArray
    faces: Int32Array
    normals: FloatArray
    side: NDArray[np.int8]
    top: FloatArray
    hangs: BoolArray

    def with_uv(self, uv: FloatArray) -> TriangleMesh:
        return TriangleMesh(self.points, self.faces, uv, self.normals)


def _split(mesh: TriangleMesh, *, vertical: float = VERTICAL, draped: bool = False) -> _Split:
    vertices, faces = np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces)
    label, mask, top, hangs = _label_faces(vertices, faces, vertical, draped)
    first = np.concatenate(([0], np.cumsum(_COUNT[mask])))
    split = np.repeat(np.arange(len(vertices)), _COUNT[mask])
    new_faces, normals = _split_faces(vertices, faces, label, mask, first[:-1], len(split))
    return _Split(vertices[split], new_faces, normals, _sides(mask), top[split], hangs[split])


_COUNT = np.array([int(m).bit_count() for m in range(1 << LABELS)], dtype=np.int64)


def _sides(mask: NDArray[np.uint16]) -> NDArray[np.int8]:
    """Return the label of each split vertex, vertex by vertex, ascending."""
    bits = np.unpackbits(mask.astype("<u2").view(np.uint8).reshape(-1, 2), axis=1, bitorder="little")
    return np.nonzero(bits[:, :LABELS])[1].astype(np.int8)


def _unfold(
    points: FloatArray, top: FloatArray, side: NDArray[np.int8], bounds: FloatArray, span: float
) -> FloatArray:
    """Return (n, 2) coordinates on the unfolded cube, in units of the texture.

    Down a side the coordinate grows with the depth: below the upper rim for a skirt, below the highest point
    for a steep slope.
    """
    (west, south, _), (east, north, highest) = bounds
    uv: FloatArray = (points[:, :2] - (west, south)) / span
    depth = np.where(side >= FLAT, top, highest)
    depth -= points[:, 2]
    depth /= span
    direction = side % FLAT
    for where, axis, edge, sign in (
        (EAST, 0, (east - west) / span, 1),
        (WEST, 0, 0.0, -1),
        (NORTH, 1, (north - south) / span, 1),
        (SOUTH, 1, 0.0, -1),
    ):
        chosen = direction == where
        uv[chosen, axis] = edge + sign * depth[chosen]
    below = direction == DOWN
    uv[below, 0] = (east - west) / span - uv[below, 0]
    return uv


@njit
def _normal(vertices: FloatArray, a: int, b: int, c: int) -> tuple[float, float, float]:
    """Return the normal of a triangle, with twice its area as length."""
    x, y, z = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    ux, uy, uz = vertices[b, 0] - x, vertices[b, 1] - y, vertices[b, 2] - z
    vx, vy, vz = vertices[c, 0] - x, vertices[c, 1] - y, vertices[c, 2] - z
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@njit
def _label_faces(
    vertices: FloatArray, faces: Int32Array, vertical: float, draped: bool
) -> tuple[NDArray[np.int8], NDArray[np.uint16], FloatArray, BoolArray]:
    """Return face labels, and each vertex's label bits, rim height and hanging edges.

    Args:
        vertices: (n, 3) meters.
        faces: (m, 3) vertex indices.
        vertical: largest upward share of a vertical face's normal.
        draped: whether all upward faces belong to the upper side.
    """
    label = np.empty(len(faces), np.int8)
    mask = np.zeros(len(vertices), np.uint16)
    top = vertices[:, 2].copy()
    hangs = np.zeros(len(vertices), np.bool_)
    for i in range(len(faces)):
        a, b, c = faces[i]
        nx, ny, nz = _normal(vertices, a, b, c)
        ax, ay, az = abs(nx), abs(ny), abs(nz)
        if az >= ax and az >= ay:
            side = UP if nz >= 0 else DOWN
        elif ax >= ay:
            side = EAST if nx > 0 else WEST
        else:
            side = NORTH if ny > 0 else SOUTH
        if draped and nz > vertical * (ax + ay + az):
            side = UP
        if nz <= vertical * (ax + ay + az):
            side += FLAT
            for k in range(3):
                p, q = faces[i, k], faces[i, (k + 1) % 3]
                if vertices[p, 0] == vertices[q, 0] and vertices[p, 1] == vertices[q, 1]:
                    rim = max(top[p], top[q])
                    top[p] = rim
                    top[q] = rim
                    hangs[p] = hangs[q] = True
        label[i] = side
        for k in range(3):
            mask[faces[i, k]] |= np.uint16(1 << side)
    return label, mask, top, hangs


@njit
def _split_faces(
    vertices: FloatArray,
    faces: Int32Array,
    label: NDArray[np.int8],
    mask: NDArray[np.uint16],
    first: IntArray,
    n: int,
) -> tuple[Int32Array, FloatArray]:
    """Return the faces on split vertices, and unit normals weighted by area.

    The ground shares normals across sides of the cube; each flat side has its own.
    """
    out = np.empty_like(faces)
    normals = np.zeros((n, 3))
    for i in range(len(faces)):
        nx, ny, nz = _normal(vertices, faces[i, 0], faces[i, 1], faces[i, 2])
        for k in range(3):
            v = faces[i, k]
            j = first[v]
            for other in range(LABELS):
                if not mask[v] >> other & 1:
                    continue
                if other == label[i]:
                    out[i, k] = j
                if other == label[i] or (other < FLAT and label[i] < FLAT):
                    normals[j, 0] += nx
                    normals[j, 1] += ny
                    normals[j, 2] += nz
                j += 1
    for j in range(n):
        length = np.sqrt(normals[j, 0] ** 2 + normals[j, 1] ** 2 + normals[j, 2] ** 2)
        if length > 0:
            normals[j] /= length
        else:
            normals[j, 2] = 1.0
    return out, normals
