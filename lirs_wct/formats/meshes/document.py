"""Shapes of a mesh file as it states them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.geometry.mesh import TriangleMesh

MOST_NODES = 1_000_000
"""Visits of nodes in a scene; more mean that nodes contain themselves."""
_AREA, _DIGITS = 1e-3, 1e-5
"""Shares of the area, and of the largest coordinate (in float32), by which another reading may differ."""


@dataclass(frozen=True)
class Document:
    """Content of a mesh file.

    Attributes:
        parts: shapes, one for each instance, in the file's frame.
        looks: whether it has materials, texture coordinates or colors.
        odd_looks: whether trimesh would misread them.
        notes: parts that are left out or simplified, a line each.
    """

    parts: Sequence[TriangleMesh]
    looks: bool = False
    odd_looks: bool = False
    notes: Sequence[str] = field(default_factory=list)

    @cached_property
    def whole(self) -> TriangleMesh:
        """All shapes as one."""
        if len(self.parts) == 1:
            return self.parts[0]
        before = np.cumsum([0, *(len(part.vertices) for part in self.parts)]).astype(np.int32)
        faces = [part.faces + n for part, n in zip(self.parts, before, strict=False)]
        points = [part.vertices for part in self.parts]
        return TriangleMesh(
            np.concatenate([np.empty((0, 3)), *points]), np.concatenate([np.empty((0, 3), np.int32), *faces])
        )


def is_same(mesh: TriangleMesh, other: TriangleMesh) -> bool:
    """Return whether two readings of a file agree on triangles, extent and area."""
    if len(mesh.faces) != len(other.faces):
        return False
    corners, others = mesh.vertices[mesh.faces], other.vertices[other.faces]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    noise = _DIGITS * float(np.abs((low, high)).max())
    off = np.abs((low - others.min(axis=(0, 1)), high - others.max(axis=(0, 1)))).max()
    area = float(mesh.face_areas.sum())
    return bool(off <= noise and abs(area - other.face_areas.sum()) <= _AREA * area)


def place_triangles(points: FloatArray, triangles: IntArray, matrix: FloatArray) -> TriangleMesh:
    """Return triangles moved by a 4x4 matrix; a mirror keeps their outside."""
    faces = triangles[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else triangles
    return TriangleMesh(points @ matrix[:3, :3].T + matrix[:3, 3], np.ascontiguousarray(faces, np.int32))


def numbers(text: str | bytes, kind: type[np.number[Any]]) -> NDArray[Any]:
    """Return the numbers of a text.

    Raises:
        ValueError: a word is no number.
    """
    if not text.strip():
        return np.empty(0, kind)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, kind, sep=" ")
        except (DeprecationWarning, ValueError) as error:  # by the version of NumPy
            raise ValueError("is damaged: a number is expected") from error
