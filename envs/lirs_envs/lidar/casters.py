"""Ray casters of a simulated world, by the builtin traversal or by MuJoCo."""

from __future__ import annotations

from typing import Literal, get_args

import mujoco
import numpy as np

from lirs_envs.actors.walker_rays import meet_walkers
from lirs_envs.actors.walkers import WALKER_GROUP, Walkers
from lirs_envs.lidar.mesh_rays import MeshCaster
from lirs_envs.lidar.ray_casting import Caster, RayCaster, mujoco_ranges
from lirs_envs.props import PROP_GROUP
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.errors import unknown_name
from lirs_wct.export.mjcf import RAY_GROUP, TERRAIN_GROUP
from lirs_wct.world import World

Rays = Literal["builtin", "mujoco"]
RAYS: tuple[Rays, ...] = get_args(Rays)
"""Whose rays meet the world: the builtin ones, or MuJoCo's (for comparison; 20 to 10,000 times slower)."""


def resolve_rays(name: str) -> Rays:
    """Return the ray caster of a name.

    Raises:
        ConfigError: there is no such ray caster.
    """
    for rays in RAYS:
        if name == rays:
            return rays
    raise unknown_name("rays", name, RAYS)


class GeomCaster:
    """MuJoCo's rays on groups of its geoms, in the present state."""

    def __init__(self, data: mujoco.MjData, groups: tuple[int, ...]) -> None:
        self._data, self._groups = data, groups

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) ranges (see `lirs_envs.lidar.ray_casting.Caster`)."""
        # Poses of geoms are those before the last step; bringing them up to date does not change stepping.
        model = self._data.model
        mujoco.mj_kinematics(model, self._data)
        return mujoco_ranges(model, self._data, origins, directions, max_range, groups=self._groups)


class NearestCaster:
    """The nearer range of two casters."""

    def __init__(self, first: Caster, second: Caster) -> None:
        self._first, self._second = first, second

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) ranges (see `lirs_envs.lidar.ray_casting.Caster`)."""
        rays = (origins, directions, max_range)
        nearest: FloatArray = np.minimum(self._first.ranges(*rays), self._second.ranges(*rays))
        return nearest


class WalkerCaster:
    """What another caster meets, and walkers.

    Attributes:
        met: (n,) which rays of the last call met a walker.

    Args:
        caster: of all else; with MuJoCo's rays of the walkers, too.
        walkers: that are met.
        builtin: whether the builtin rays meet the walkers.
    """

    def __init__(self, caster: Caster, walkers: Walkers, *, builtin: bool) -> None:
        self._caster, self._walkers, self._builtin = caster, walkers, builtin
        self.met: BoolArray = np.zeros(0, np.bool_)

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) ranges (see `lirs_envs.lidar.ray_casting.Caster`)."""
        ranges = self._caster.ranges(origins, directions, max_range)
        self.met = np.empty(len(ranges), np.bool_)
        nearest = np.empty_like(ranges)
        meet_walkers(
            self._walkers.centers, origins.reshape(-1, 3), directions, max_range, ranges, nearest, self.met
        )
        return nearest if self._builtin else ranges


def make_caster(
    world: World, rays: Rays, props: bool, data: mujoco.MjData, walkers: Walkers | None = None
) -> Caster:
    """Return the caster of a world and of what else is there but the robot itself.

    Args:
        world: ground and walls.
        rays: whose rays.
        props: whether the data's model has props.
        data: MuJoCo's, for props and for its own rays.
        walkers: that are seen.

    Raises:
        ConfigError: builtin rays on a mesh with overhangs need embreex, which is not installed.
    """
    if walkers is not None:
        groups = (WALKER_GROUP,) if rays == "mujoco" else ()
        return WalkerCaster(_still_caster(world, rays, props, data, groups), walkers, builtin=not groups)
    return _still_caster(world, rays, props, data)


def _still_caster(
    world: World, rays: Rays, props: bool, data: mujoco.MjData, groups: tuple[int, ...] = ()
) -> Caster:
    groups = (*groups, PROP_GROUP) if props else groups
    if rays == "mujoco":
        ground = RAY_GROUP if world.overhangs else TERRAIN_GROUP
        return GeomCaster(data, (*groups, ground))
    caster = MeshCaster(world.mesh) if world.overhangs else RayCaster(world.surface, world.walls)
    return NearestCaster(caster, GeomCaster(data, groups)) if groups else caster
