"""Distance of a world's mesh from the surface that it represents."""

from __future__ import annotations

import numpy as np

from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.sources.rasterize import rasterize_heights
from lirs_wct.world import World


def mesh_error(world: World, mesh: TriangleMesh | None = None) -> float:
    """Return the largest vertical mesh error at the surface's nodes, meters.

    Args:
        world: whose surface.
        mesh: that stands for it; None = the world's own.
    """
    surface = world.surface
    chosen = world.mesh if mesh is None else mesh
    top = rasterize_heights(chosen, (*surface.origin, *surface.cell), surface.shape)
    top -= surface.south_up
    return float(np.nanmax(np.abs(top, out=top)))
