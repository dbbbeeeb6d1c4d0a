"""The ground as convex parts, for contact without a height field: prisms, or a convex decomposition."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lirs_wct.arrays import FloatArray
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.contact.surface_shell import shell_parts
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.simplify import simplified_solid
from lirs_wct.world import World

MAX_PRISMS = 20_000
"""A step costs about 1.7 us for each thousand: with these, no robot's takes more than 60 us (measured: 46 to
48 us at 16,447, 59 to 65 us at 26,981)."""
PRISM_ERROR = 0.01
"""Vertical deviation of prisms from the ground where the world has no budget of its own, meters."""
DEPTH = 1.0
"""Meters that a prism reaches below the lowest ground; contacts push out the shorter way: up."""
FEW_FACES = 200
"""Faces of a body that CoACD cuts into fewer parts than there are faces, within a second or so."""
MAX_CONVEX = 5000
"""Faces of a body above which nobody asks whether it is convex."""
CONCAVITY = 0.01
"""How far a part's hull may be from the part, as CoACD measures it (Wei et al. 2022)."""


def contact_parts(world: World, geometry: ContactGeometry) -> Iterator[FloatArray]:
    """Yield the convex parts of a world.

    Raises:
        ConfigError: more prisms than `MAX_PRISMS`, or coacd is not installed.
    """
    return prisms(world) if geometry == "prisms" else convex_parts(world.mesh)


def prisms(world: World) -> Iterator[FloatArray]:
    """Yield one prism for each triangle of the simplified mesh that is seen from above.

    Raises:
        ConfigError: there are more than `MAX_PRISMS`.
    """
    if world.export_options.limited or world.solid is not None:
        mesh, budget = world.mesh, ""
    else:
        mesh, budget = simplified_solid(world.surface, max_error=PRISM_ERROR), f" within {PRISM_ERROR:g} m"
    top = mesh.faces[mesh.face_normals[:, 2] > 1e-9]
    if len(top) > MAX_PRISMS:
        raise ConfigError(
            f"{world.name}: terrain prisms would need {len(top)}{budget}, at most {MAX_PRISMS} are legal; "
            "give --max-error or --max-triangles, or take hfield"
        )
    corners = mesh.vertices[top]
    base = corners.copy()
    base[..., 2] = float(mesh.vertices[:, 2].min()) - DEPTH
    yield from np.concatenate((corners, base), axis=1)


def convex_parts(mesh: TriangleMesh) -> Iterator[FloatArray]:
    """Yield the convex parts of closed bodies, each body on its own.

    One that is convex is a part. One of few faces is cut up by CoACD, one of up to `MAX_PRISMS` is touched on
    its very triangles (`shell_parts`): CoACD takes minutes for thousands of faces, and its parts bulge by
    1 % of the body. Larger ones are left to CoACD.

    Wei et al. 2022, "Approximate convex decomposition for 3D meshes with collision-aware concavity and
    tree search" (CoACD); the same mesh gives the same parts. Each closed body is cut on its own: where bodies
    overlap, CoACD does not come to an end with all of them at once.

    Raises:
        ConfigError: coacd is not installed.
    """
    try:
        coacd: Any = import_module("coacd")
    except ImportError:
        raise ConfigError("terrain convex needs the package coacd: pip install 'lirs-wct[mesh]'") from None
    coacd.set_log_level("error")
    for body in bodies(mesh):
        if _is_convex(body):
            yield np.unique(body.vertices, axis=0)
            continue
        if FEW_FACES < len(body.faces) <= MAX_PRISMS:
            yield from shell_parts(body)
            continue
        if len(body.faces) > MAX_PRISMS:
            warnings.warn(
                f"convex parts: CoACD cuts a body of {len(body.faces)} faces, which takes minutes; one of "
                f"up to {MAX_PRISMS} is touched on its faces at once",
                stacklevel=2,
            )
        parts = coacd.run_coacd(
            coacd.Mesh(body.vertices, body.faces), threshold=CONCAVITY, preprocess_mode="off", seed=0
        )
        for vertices, _ in parts:
            yield np.asarray(vertices, dtype=np.float64)


def _is_convex(body: TriangleMesh) -> bool:
    """Whether no vertex lies before the plane of a face, to rounding."""
    if len(body.faces) > MAX_CONVEX:
        return False
    size = float(np.ptp(body.bounds, axis=0).max())
    normals, on = body.face_normals, body.vertices[body.faces[:, 0]]
    before = body.vertices @ normals.T - (normals * on).sum(axis=1)
    return bool((before < 1e-6 * size).all())


def bodies(mesh: TriangleMesh) -> Iterator[TriangleMesh]:
    """Yield the pieces of a mesh that share no vertex with each other, in the order of their vertices."""
    a, b, c = mesh.faces.T
    n = len(mesh.vertices)
    edges = coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, c])), shape=(n, n))
    _, label = connected_components(edges, directed=False)
    for piece in np.unique(label[a]):
        faces = mesh.faces[label[a] == piece]
        used, renumbered = np.unique(faces, return_inverse=True)
        yield TriangleMesh(mesh.vertices[used], renumbered.reshape(-1, 3).astype(np.int32))
