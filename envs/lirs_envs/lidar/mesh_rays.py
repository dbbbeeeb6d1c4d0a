"""Rays against the triangles of a true mesh, through Embree.

Wald et al. 2014, "Embree: a kernel framework for efficient CPU ray tracing". Embree computes in single
precision. It finds the triangle that a ray hits, in a frame at the mesh's center. This module computes the
distance to that triangle in double precision.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from lirs_envs.lidar.reflection import GROUND, reflect
from lirs_wct import ConfigError, TriangleMesh
from lirs_wct.arrays import FloatArray, Int32Array
from lirs_wct.kernels import njit

SLACK = 1e-4
"""Meters added to Embree's largest range: single precision at a kilometer."""


class MeshCaster:
    """Ranges to the triangles of a mesh, from outside and from inside alike.

    Raises:
        ConfigError: embreex is not installed.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self._middle = mesh.bounds.mean(axis=0)
        self._vertices = np.ascontiguousarray(mesh.vertices - self._middle)
        self._faces = np.ascontiguousarray(mesh.faces, dtype=np.int32)
        self._build_scene()

    def _build_scene(self) -> None:
        try:
            scenes: Any = import_module("embreex.rtcore_scene")
            meshes: Any = import_module("embreex.mesh_construction")
        except ImportError:
            raise ConfigError(
                "the lidar on a mesh with overhangs needs the package embreex: pip install '.[mesh]', "
                "or take rays 'mujoco'"
            ) from None
        # Robust: no ray slips between two triangles.
        self._scene: Any = scenes.EmbreeScene(robust=True)
        self._geometry: Any = meshes.TriangleMesh(self._scene, self._vertices.astype(np.float32), self._faces)

    def __deepcopy__(self, memo: dict[int, Any]) -> MeshCaster:
        """Return the caster itself: it is a value, and copies of a simulation share it."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        # Embree's scene lives in this process only.
        return {k: v for k, v in self.__dict__.items() if k not in ("_scene", "_geometry")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._build_scene()

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) ranges (see `lirs_envs.lidar.ray_casting.Caster`)."""
        return self._met(origins, directions, max_range)[0]

    def hits(
        self, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return ranges and reflectances (see `lirs_envs.lidar.ray_casting.Caster`)."""
        ranges, faces = self._met(origins, directions, max_range)
        a, b, c = self._vertices[self._faces[faces]].transpose(1, 0, 2)
        return ranges, reflect(GROUND, np.cross(b - a, c - a), directions)

    def _met(
        self, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> tuple[FloatArray, Int32Array]:
        """Return (n,) ranges and triangles, -1 = none."""
        origins = origins - self._middle
        starts = np.empty(directions.shape, np.float32)
        starts[:] = origins
        reach = np.full(len(directions), min(max_range + SLACK, 1e30), np.float32)
        met = self._scene.run(starts, directions.astype(np.float32), dists=reach, output=True)
        ranges = np.empty(len(directions))
        starts_exact = np.broadcast_to(origins, directions.shape)
        _refine(self._vertices, self._faces, met["primID"], starts_exact, directions, max_range, ranges)
        return ranges, met["primID"]


@njit(cache=True, nogil=True)
def _refine(
    vertices: FloatArray,
    faces: Int32Array,
    met: Int32Array,
    origins: FloatArray,
    directions: FloatArray,
    max_range: float,
    ranges: FloatArray,
) -> None:
    """Fill `ranges` (n,) with the distance to each ray's triangle `met` (-1 = none)."""
    for k in range(len(met)):
        ranges[k] = np.inf
        if met[k] >= 0:
            t = _plane_range(vertices, faces[met[k]], origins[k], directions[k])
            if t <= max_range:
                ranges[k] = t


@njit(cache=True, forceinline=True)
def _plane_range(vertices: FloatArray, face: Int32Array, o: FloatArray, d: FloatArray) -> float:
    """Return the distance along a ray to a triangle's plane.

    It is limited to the distances of the corners along the ray.

    A ray that grazes the plane meets it anywhere.
    """
    ax, ay, az = vertices[face[0], 0] - o[0], vertices[face[0], 1] - o[1], vertices[face[0], 2] - o[2]
    bx, by, bz = vertices[face[1], 0] - o[0], vertices[face[1], 1] - o[1], vertices[face[1], 2] - o[2]
    cx, cy, cz = vertices[face[2], 0] - o[0], vertices[face[2], 1] - o[1], vertices[face[2], 2] - o[2]
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    along = ax * d[0] + ay * d[1] + az * d[2]
    along_b, along_c = bx * d[0] + by * d[1] + bz * d[2], cx * d[0] + cy * d[1] + cz * d[2]
    near, far = min(along, along_b, along_c), max(along, along_b, along_c)
    slope = nx * d[0] + ny * d[1] + nz * d[2]
    t = (nx * ax + ny * ay + nz * az) / slope if slope != 0.0 else near
    clipped: float = max(min(max(t, near), far), 0.0)
    return clipped
