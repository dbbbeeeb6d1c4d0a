"""Convex parts of the ground for contact: prisms, hulls or a thin shell.

A shell (`shell_parts`) has one part for each triangle of a closed body, so that contacts are exact on its
triangles. A part is the hull of its triangle and of the same triangle moved inward along the normals of its
corners. Neighbors share these normals: there are no gaps between parts.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
import scipy  # its modules load on first use

from lirs_wct.arrays import BoolArray, FloatArray, Int32Array, njit
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.simplify import simplified_solid
from lirs_wct.world import World

MAX_PRISMS = 20_000
"""Each thousand prisms cost about 1.7 us per step. With this limit, no robot's step takes more than 60 us
(measured: 46 to 48 us at 16,447 prisms, 59 to 65 us at 26,981)."""
PRISM_ERROR = 0.01
"""Vertical deviation of prisms from the ground if the world has no budget, meters."""
DEPTH = 1.0
"""Meters that a prism reaches below the lowest ground; contacts push along the shorter direction, up."""
FEW_FACES = 200
"""Faces of a body that CoACD cuts into fewer parts than there are faces, within a second or so."""
MAX_CONVEX = 5000
"""Faces of a body above which it counts as not convex, without a test."""
CONCAVITY = 0.01
"""Largest distance of a part's hull from the part, as CoACD measures it (Wei et al. 2022)."""
SHELL_DEPTH = 0.1
"""Meters that a part reaches inward; contacts push the shorter way and are 1 to 2 cm deep at 3 m/s."""
SHARE = 0.45
"""Largest share of the body's thickness that a part reaches inward at a corner: two sides do not meet."""
LEAST_AREA = 1e-10
"""Square meters below which a triangle has no contact."""
GRAZING = 0.2
"""Cosine of the angle between a corner's normal and a triangle's below which the triangle takes its own."""


def prisms(world: World) -> Iterator[FloatArray]:
    """Yield one prism for each upward triangle of the simplified mesh."""
    if world.export_options.limited or world.solid is not None:
        mesh, budget = world.mesh, ""
    else:
        mesh, budget = simplified_solid(world.surface, max_error=PRISM_ERROR), f" within {PRISM_ERROR:g} m"
    top = mesh.faces[mesh.face_normals[:, 2] > 1e-9]
    if len(top) > MAX_PRISMS:
        raise ConfigError(
            f"{world.name}: terrain prisms would need {len(top)}{budget}, at most {MAX_PRISMS} are legal; "
            "give --max-error or --option max-triangles=N, or take hfield"
        )
    corners = mesh.vertices[top]
    base = corners.copy()
    base[..., 2] = float(mesh.vertices[:, 2].min()) - DEPTH
    yield from np.concatenate((corners, base), axis=1)


def convex_parts(mesh: TriangleMesh) -> Iterator[FloatArray]:
    """Yield the convex parts of bodies, body by body.

    A closed convex body is one part. CoACD cuts a closed body of few faces. A body of up to `MAX_PRISMS`
    faces becomes a shell with contact on its triangles (`shell_parts`), on their front where it is open:
    CoACD takes minutes for thousands of faces, and its parts bulge by 1 % of the body. CoACD also cuts
    larger bodies.

    Wei et al. 2022, "Approximate convex decomposition for 3D meshes with collision-aware concavity and
    tree search" (CoACD); the same mesh gives the same parts. Each closed body is cut separately, because
    CoACD does not terminate on several overlapping bodies.
    """
    try:
        coacd: Any = import_module("coacd")
    except ImportError:
        raise ConfigError("terrain convex needs the package coacd: pip install 'lirs-wct[mesh]'") from None
    coacd.set_log_level("error")
    for body in bodies(mesh):
        closed = body.is_watertight
        if closed and _is_convex(body):
            yield np.unique(body.vertices, axis=0)
            continue
        if len(body.faces) <= MAX_PRISMS and not (closed and len(body.faces) <= FEW_FACES):
            yield from shell_parts(body)
            continue
        if len(body.faces) > MAX_PRISMS:
            warnings.warn(
                f"convex parts: CoACD cuts a body of {len(body.faces)} faces, which takes minutes; a body of "
                f"up to {MAX_PRISMS} faces needs no cutting",
                stacklevel=2,
            )
        parts = coacd.run_coacd(
            coacd.Mesh(body.vertices, body.faces),
            threshold=CONCAVITY,
            preprocess_mode="off" if closed else "on",
            seed=0,
        )
        for vertices, _ in parts:
            yield np.asarray(vertices, dtype=np.float64)


def _is_convex(body: TriangleMesh) -> bool:
    """Whether no vertex lies outside the plane of a face, within rounding."""
    if len(body.faces) > MAX_CONVEX:
        return False
    size = float(np.ptp(body.bounds, axis=0).max())
    normals, on = body.face_normals, body.vertices[body.faces[:, 0]]
    before = body.vertices @ normals.T - (normals * on).sum(axis=1)
    return bool((before < 1e-6 * size).all())


def bodies(mesh: TriangleMesh) -> Iterator[TriangleMesh]:
    """Yield the connected components of a mesh, in the order of their vertices."""
    a, b, c = mesh.faces.T
    n = len(mesh.vertices)
    edges = scipy.sparse.coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, c])), shape=(n, n))
    _, label = scipy.sparse.csgraph.connected_components(edges, directed=False)
    for piece in np.unique(label[a]):
        yield mesh.part(label[a] == piece)


def shell_parts(body: TriangleMesh) -> Iterator[FloatArray]:
    """Yield the (6, 3) corners of each shell part of a closed body."""
    normals = body.face_normals
    corner = _corner_normals(body, normals)
    size = float(np.ptp(body.bounds, axis=0).max())
    thickness = _thickness(body.vertices, body.faces, corner, 1e-6 * size)
    depth = np.minimum(SHELL_DEPTH, SHARE * thickness)
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
    """Return (n, 3) unit normals of the vertices, from face normals weighted by angle."""
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


@njit
def _thickness(vertices: FloatArray, faces: Int32Array, normals: FloatArray, least: float) -> FloatArray:
    """Return (n,) distances from each vertex along its inward normal to the next face.

    Ray-triangle test: Moeller and Trumbore 1997.
    """
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
            # d x s: its products with the edges are the barycentric coordinates.
            mx, my, mz = dy * sz - dz * sy, dz * sx - dx * sz, dx * sy - dy * sx
            u = -(gx * mx + gy * my + gz * mz) / det
            w = (ex * mx + ey * my + ez * mz) / det
            if u >= -1e-9 and w >= -1e-9 and u + w <= 1 + 1e-9:
                found[v] = t
    return found


@njit
def _winding(vertices: FloatArray, faces: Int32Array, points: FloatArray) -> Int32Array:
    """Return (n,) numbers of bodies around each point: tops above it minus bottoms above it."""
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
