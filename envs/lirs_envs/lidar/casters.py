"""What the laser range finder sees of a world, and through whose rays."""

from __future__ import annotations

from typing import Literal, get_args

import mujoco

from lirs_envs.lidar.mesh_rays import MeshCaster
from lirs_envs.lidar.ray_casting import Caster, RayCaster, mujoco_ranges
from lirs_envs.props import PROP_GROUP
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import unknown_name
from lirs_wct.export.mjcf import SEEN_GROUP, TERRAIN_GROUP
from lirs_wct.world import World

Rays = Literal["ours", "mujoco"]
RAYS: tuple[Rays, ...] = get_args(Rays)
"""Whose rays meet the world: our traversal, or MuJoCo's (for comparison; 20 to 10,000 times slower)."""


def check_rays(rays: str) -> None:
    """Tell whether there are such rays.

    Raises:
        ConfigError: there are not; the message lists those that are.
    """
    if rays not in RAYS:
        raise unknown_name("rays", rays, RAYS)


class GeomCaster:
    """MuJoCo's rays on groups of its geoms, as they lie in the present state."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, groups: tuple[int, ...]) -> None:
        self._model, self._data, self._groups = model, data, groups

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) ranges (see `lirs_envs.lidar.ray_casting.Caster`)."""
        # Places of geoms are those before the last step: brought up to date, the stepping goes on as without.
        mujoco.mj_kinematics(self._model, self._data)
        return mujoco_ranges(self._model, self._data, origins, directions, max_range, groups=self._groups)


def make_casters(
    world: World, rays: Rays, props: bool, model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[Caster, Caster | None]:
    """Return what the laser sees of the world, and of what else stands there; never the robot itself.

    Raises:
        ConfigError: our rays on a mesh with overhangs need embreex, which is not installed.
    """
    groups = (PROP_GROUP,) if props else ()
    if rays == "mujoco":
        ground = SEEN_GROUP if world.overhangs else TERRAIN_GROUP
        return GeomCaster(model, data, (*groups, ground)), None
    others = GeomCaster(model, data, groups) if groups else None
    return MeshCaster(world.mesh) if world.overhangs else RayCaster(world.surface, world.walls), others
