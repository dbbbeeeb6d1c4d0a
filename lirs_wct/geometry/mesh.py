"""A triangle mesh as plain arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import FloatArray, Int32Array
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

    def rotated_x(self, degrees: float) -> TriangleMesh:
        """Rotate the mesh and its normals about the x axis, from y towards z."""
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
