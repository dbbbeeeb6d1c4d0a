"""How far a world's mesh lies from the surface that it stands for."""

from __future__ import annotations

import numpy as np

from lirs_wct.sources.rasterize import rasterize_heights
from lirs_wct.world import World


def mesh_error(world: World) -> float:
    """Return the largest vertical distance of the world's mesh from its surface at the nodes, metres."""
    surface = world.surface
    top = rasterize_heights(world.mesh, (*surface.origin, *surface.cell), surface.shape)
    return float(np.nanmax(np.abs(top - surface.south_up)))
