"""A triangle mesh as plain arrays, its heights from above, and its tiles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, FloatArray, Int32Array, njit
from lirs_wct.errors import ConfigError


@dataclass(frozen=True, slots=True)
class TriangleMesh:
    """Triangles in the world frame, counter-clockwise seen from outside.

    Attributes:
        vertices: (n, 3) float64 meters.
        faces: (m, 3) int32 vertex indices.
        uv: (n, 2) float64 texture coordinates, or None.
        normals: (n, 3) float64 unit vertex normals, or None.

    Raises:
        ConfigError: an array has the wrong shape.
    """

    vertices: FloatArray
    faces: Int32Array
    uv: FloatArray | None = None
    normals: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(self.vertices)
        shapes = {"vertices": self.vertices.shape == (n, 3), "faces": self.faces.shape[1:] == (3,)}
        shapes["uv"] = self.uv is None or self.uv.shape == (n, 2)
        shapes["normals"] = self.normals is None or self.normals.shape == (n, 3)
        wrong = [name for name, ok in shapes.items() if not ok]
        if wrong:
            raise ConfigError(f"mesh of {n} vertices has arrays of the wrong shape: {', '.join(wrong)}")

    @property
    def bounds(self) -> FloatArray:
        """(2, 3) lowest and highest corner, meters."""
        return np.stack((self.vertices.min(axis=0), self.vertices.max(axis=0)))

    @property
    def face_normals(self) -> FloatArray:
        """(m, 3) unit normals; zero for a triangle without area."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        n = np.cross(b - a, c - a)
        length = np.linalg.norm(n, axis=1, keepdims=True)
        unit: FloatArray = np.divide(n, length, out=np.zeros_like(n), where=length > 0)
        return unit

    @property
    def face_areas(self) -> FloatArray:
        """(m,) areas, square meters."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        areas: FloatArray = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        return areas

    @property
    def volume(self) -> float:
        """Enclosed volume, cubic meters (signed sum of tetrahedra; meaningful where closed)."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)

    @property
    def is_watertight(self) -> bool:
        """Whether every edge joins exactly two triangles that agree on its direction."""
        f = self.faces.astype(np.int64)
        edges = np.concatenate((f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]))
        n = len(self.vertices)
        forward = np.sort(edges[:, 0] * n + edges[:, 1])
        backward = np.sort(edges[:, 1] * n + edges[:, 0])
        unique = len(forward) == 0 or bool(np.all(np.diff(forward) > 0))
        return unique and bool(np.array_equal(forward, backward))

    @property
    def is_watertight_as_written(self) -> bool:
        """Whether the mesh is watertight after an STL round trip (float32, equal vertices merged)."""
        written = self.vertices.astype(np.float32).astype(np.float64)
        return weld(TriangleMesh(written, self.faces)).is_watertight

    def part(self, chosen: BoolArray) -> TriangleMesh:
        """Return the chosen faces (m,) with their vertices, without attributes."""
        used, faces = np.unique(self.faces[chosen], return_inverse=True)
        return TriangleMesh(self.vertices[used], faces.reshape(-1, 3).astype(np.int32))

    def rotated_x(self, degrees: float) -> TriangleMesh:
        """Rotate the mesh and its normals about the x axis, from y towards z."""
        if degrees == 0:
            return self
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        turn = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
        normals = None if self.normals is None else self.normals @ turn
        return replace(self, vertices=self.vertices @ turn, normals=normals)


def weld(mesh: TriangleMesh) -> TriangleMesh:
    """Merge vertices at equal positions; drop texture coordinates and normals, keep all triangles."""
    # Adding 0 makes -0.0 and 0.0 equal.
    vertices = np.ascontiguousarray(mesh.vertices + 0.0)
    keys = vertices.view(np.uint64)
    mixed: NDArray[np.uint64] = keys[:, 0].copy()
    for column in (1, 2):
        mixed = (mixed * np.uint64(0x9E3779B97F4A7C15)) ^ (mixed >> np.uint64(29)) ^ keys[:, column]
    _, first, index = np.unique(mixed, return_index=True, return_inverse=True)
    if not np.array_equal(vertices[first][index], vertices):
        # Two positions with one hash: very rare, so the slow exact way is enough.
        _, first, index = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    return TriangleMesh(vertices[first], index.reshape(-1)[mesh.faces].astype(np.int32))


Grid = tuple[float, float, float, float]
"""x and y of the south-west node, spacing eastward and northward, meters."""
_SLACK = 1e-9
"""Tolerance at a triangle's edges, share of the triangle, so that no node falls between two triangles."""


def rasterize_heights(mesh: TriangleMesh, grid: Grid, shape: tuple[int, int]) -> FloatArray:
    """Return (rows, cols) heights of the highest point at nodes, row 0 = south.

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


MUJOCO_FACES = 200_000
"""MuJoCo refuses a mesh file with more triangles."""


def split_tiles(mesh: TriangleMesh, *, aim: int, most: int = MUJOCO_FACES) -> Iterator[TriangleMesh]:
    """Yield tiles of a mesh: squares of the ground plan.

    Each has about `aim` and at most `most` triangles. A triangle belongs to the square of its first vertex.
    """
    seen = np.full(len(mesh.vertices), -1, dtype=np.int32)
    side = max(1, round((len(mesh.faces) / aim) ** 0.5))
    tile = np.zeros(len(mesh.faces), dtype=np.int32)
    for axis in (0, 1):
        x = mesh.vertices[:, axis]
        step = (x[mesh.faces[:, 0]] - x.min()) * (side / max(float(np.ptp(x)), 1e-9))
        tile = tile * side + np.minimum(step.astype(np.int32), side - 1)
    order = np.argsort(tile, kind="stable").astype(np.int32)
    ends = np.cumsum(np.bincount(tile, minlength=side * side))
    for start, end in zip(np.concatenate(([0], ends[:-1])), ends, strict=True):
        for i in range(start, end, most):
            faces, used = _renumber(mesh.faces, order[i : min(i + most, end)], seen)
            yield TriangleMesh(
                mesh.vertices[used],
                faces,
                None if mesh.uv is None else mesh.uv[used],
                None if mesh.normals is None else mesh.normals[used],
            )


@njit
def _renumber(faces: Int32Array, chosen: Int32Array, seen: Int32Array) -> tuple[Int32Array, Int32Array]:
    """Number the vertices of faces in order; `seen` is -1 before and after."""
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
