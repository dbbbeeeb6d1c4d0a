"""What the laser range finder sees of a world, and through whose rays."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from lirs_envs.props import PROP_GROUP
from lirs_envs.raycast import RayCaster
from lirs_wct.errors import unknown_name
from lirs_wct.heightfield import HeightField
from lirs_wct.mjcf import SEEN_GROUP, TERRAIN_GROUP
from lirs_wct.world import World

Rays = Literal["ours", "mujoco"]
RAYS: tuple[Rays, ...] = get_args(Rays)
"""Whose rays meet the world: our traversal, or MuJoCo's (for comparison; 100 to 10,000 times slower)."""
FAR_BELOW = 1e4
"""Metres below a world with overhangs where its height field is put: no laser reaches there."""


def check_rays(rays: str) -> None:
    """Tell whether there are such rays.

    Raises:
        ConfigError: there are not; the message lists those that are.
    """
    if rays not in RAYS:
        raise unknown_name("rays", rays, RAYS)


def seen_groups(world: World, props: bool, rays: Rays) -> tuple[int, ...]:
    """Return the geom groups that the laser sees through MuJoCo's rays; no robot has its own geoms there."""
    ground = (TERRAIN_GROUP,) if rays == "mujoco" else ()
    mesh = (SEEN_GROUP,) if world.overhangs else ()
    return (*((PROP_GROUP,) if props else ()), *(mesh or ground))


def caster_of(world: World, rays: Rays = "ours") -> RayCaster:
    """Return the caster for surface and walls.

    There is nothing in it to be met where MuJoCo's rays are taken.
    """
    if rays == "ours" and not world.overhangs:
        return RayCaster(world.surface, world.walls)
    surface = world.surface
    low = float(surface.z.min()) - FAR_BELOW
    return RayCaster(HeightField(np.full((2, 2), low, np.float32), surface.size, surface.origin))
