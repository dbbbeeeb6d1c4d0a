"""What the laser range finder sees of a world in closed form: heights and wall cells."""

from __future__ import annotations

import numpy as np

from lirs_envs.raycast import RayCaster
from lirs_wct.heightfield import HeightField
from lirs_wct.world import World

FAR_BELOW = 1e4
"""Metres below a world with overhangs where its height field is put: no laser reaches there."""


def caster_of(world: World) -> RayCaster:
    """Return the caster for surface and walls.

    With overhangs there is nothing in it to be met: that mesh is seen by its triangles, through MuJoCo.
    """
    if not world.overhangs:
        return RayCaster(world.surface, world.walls)
    surface = world.surface
    low = float(surface.z.min()) - FAR_BELOW
    return RayCaster(HeightField(np.full((2, 2), low, np.float32), surface.size, surface.origin))
