"""Mesh files: COLLADA, STL, OBJ, PLY and GLB. Here: shapes as a file states them, with polygons cut."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.geometry.mesh import TriangleMesh

MAX_NODES = 1_000_000
"""Visits of nodes in a scene; more mean that nodes contain themselves."""
STL_HEAD = 84
STL_FACET = np.dtype([("floats", "<f4", 12), ("attribute", "<u2")])
"""Bytes before the first facet of a binary STL; its normal and three corners, and two unused bytes."""


@dataclass(frozen=True)
class Document:
    """Content of a mesh file.

    Attributes:
        parts: Shapes, one for each instance, in the file's frame.
        looks: Whether it has materials, texture coordinates or colors.
        odd_looks: Whether trimesh would misread them.
        notes: Parts that are left out or simplified, a line each.
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


def place_triangles(points: FloatArray, triangles: IntArray, matrix: FloatArray) -> TriangleMesh:
    """Return triangles moved by a 4x4 matrix; a mirror keeps their outside."""
    faces = triangles[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else triangles
    return TriangleMesh(points @ matrix[:3, :3].T + matrix[:3, 3], np.ascontiguousarray(faces, np.int32))


def numbers(text: str | bytes, kind: type[np.number[Any]]) -> NDArray[Any]:
    """Return the numbers of a text."""
    if not text.strip():
        return np.empty(0, kind)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, kind, sep=" ")
        except (DeprecationWarning, ValueError) as error:  # by the version of NumPy
            raise ValueError("is damaged: a number is expected") from error


_NOISE = 1e-6
"""Share of a polygon's area by which a triangle of a right fan may look the other way."""
_SHAKE = 1e-10
"""Share of a polygon's size by which its corners are shaken before ear clipping."""


def cut_polygons(
    points: FloatArray, corners: IntArray, counts: IntArray, rings: Mapping[int, Sequence[int]] | None = None
) -> IntArray:
    """Return triangles as (m, 3) places in `corners`, by fans where these are right.

    Args:
        points: (n, 3) Positions.
        corners: Indices of points, polygon after polygon.
        counts: Corners of each polygon.
        rings: Ends of the outline and of each hole, of polygons with holes.
    """
    if len(corners) != counts.sum() or (
        len(corners) and not 0 <= corners.min() <= corners.max() < len(points)
    ):
        raise IndexError("is damaged: a face has a corner that is not in the file")
    rings, starts, sizes = rings or {}, np.cumsum(counts) - counts, np.maximum(counts - 2, 0)
    face = np.repeat(np.arange(len(counts)), sizes)
    step, first = np.arange(len(face)) - np.repeat(np.cumsum(sizes) - sizes, sizes), starts[face]
    triangles = np.column_stack((first, first + step + 1, first + step + 2))
    wrong = _has_wrong_fan(points, corners, starts, counts)
    wrong[list(rings)] = True
    if not wrong.any():
        return triangles
    faces = np.flatnonzero(wrong).tolist()
    ears = [
        starts[i] + _clip_ears(points[corners[starts[i] :][: counts[i]]], rings.get(i, [counts[i]]))
        for i in faces
    ]
    right = ~wrong[face]
    order = np.concatenate((face[right], np.repeat(faces, [len(each) for each in ears])))
    return np.concatenate((triangles[right], *ears))[np.argsort(order, kind="stable")]


def _has_wrong_fan(points: FloatArray, corners: IntArray, starts: IntArray, counts: IntArray) -> BoolArray:
    """Return the polygons in whose fan a triangle turns against the whole (Newell's normal)."""
    wrong = np.zeros(len(counts), bool)
    for n in np.unique(counts[counts > 3]).tolist():
        faces = np.flatnonzero(counts == n)
        rings = points[corners[starts[faces][:, None] + np.arange(n)]]
        spokes = rings[:, 1:] - rings[:, :1]
        turns = np.cross(spokes[:, :-1], spokes[:, 1:])
        whole = turns.sum(axis=1)
        along = np.einsum("fsk,fk->fs", turns, whole).min(axis=1)
        wrong[faces] = along < -_NOISE * np.einsum("fk,fk->f", whole, whole)
    return wrong


def _clip_ears(corners: FloatArray, rings: Sequence[int]) -> IntArray:
    """Return the triangles of a polygon with holes, turned as its outline is."""
    import mapbox_earcut

    spokes = corners - corners[0]
    normal = np.cross(spokes[: rings[0] - 1], spokes[1 : rings[0]]).sum(axis=0)
    flat = np.delete(spokes, int(np.abs(normal).argmax()), axis=1)
    if not np.isfinite(flat).all():
        raise ValueError("has vertices that are not finite")
    # Ear clipping drops corners on straight edges. Neighbors have these, so that a closed surface would open.
    flat += np.random.default_rng(0).uniform(-_SHAKE, _SHAKE, flat.shape) * np.abs(flat).max()
    triangles = (
        mapbox_earcut.triangulate_float64(flat, np.array(rings, np.uint32)).reshape(-1, 3).astype(np.int64)
    )
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    return triangles[:, ::-1] if np.cross(b - a, c - a).sum(axis=0) @ normal < 0 else triangles


def strip_triangles(n: int, *, is_fan: bool) -> IntArray:
    """Return the triangles of a strip or fan of n corners."""
    k = np.arange(n - 2)
    return np.column_stack((0 * k, k + 1, k + 2) if is_fan else (k + k % 2, k + 1 - k % 2, k + 2))
