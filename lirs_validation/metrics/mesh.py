"""Distance of a world's mesh from the surface that it represents."""

from __future__ import annotations

import numpy as np

from lirs_wct import TriangleMesh, World
from lirs_wct.geometry.mesh import rasterize_heights

STRIP = 512
"""Rows of nodes that are compared together: less memory than the whole."""


def mesh_error(world: World, mesh: TriangleMesh | None = None) -> float:
    """Return the largest vertical error of the world's mesh, or another, at the nodes, meters."""
    surface = world.surface
    chosen = world.mesh if mesh is None else mesh
    (x, y), (dx, dy), (rows, cols) = surface.origin, surface.cell, surface.shape
    largest = 0.0
    for start in range(0, rows, STRIP):
        z = surface.z[::-1][start : start + STRIP]
        top = rasterize_heights(chosen, (x, y + start * dy, dx, dy), (len(z), cols))
        top -= z
        if np.isfinite(top).any():
            largest = max(largest, float(np.nanmax(np.abs(top, out=top))))
    return largest
