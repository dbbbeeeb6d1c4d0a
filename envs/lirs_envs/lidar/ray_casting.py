"""Ray casters: the builtin one, Embree against a true mesh, MuJoCo's rays, and combinations.

The builtin rays hit:

* the *triangles* of the height field, from above and from below. There is no skirt and no base: a ray that
  enters from the side below the border continues under the surface and hits it from below.
* the *cells* of the wall grid, as closed solids from z = 0 to the walls' height. A ray that starts inside one
  has range 0.
* no floor where a laser map has a hole: the ray continues to a wall behind, or hits nothing.

On a node, an edge or the border, the result of either neighbor is valid. A ray that only touches the surface,
or lies in it, may hit it or not. No ray slips between two triangles: the kernel does not test single
triangles. It follows the sign of (ray - surface), which is continuous, from cell to cell.

Embree (Wald et al. 2014, "Embree: a kernel framework for efficient CPU ray tracing") computes in single
precision. It finds the triangle that a ray hits, in a frame at the mesh's center. This module computes the
distance to that triangle in double precision.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection
from importlib import import_module
from typing import Any, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lirs_envs.lidar.obstacle_rays import (
    GROUND,
    NO_WALLS,
    PROP,
    WALKER,
    WALL,
    WallCells,
    build_wall_cells,
    capsule_normals,
    meet_walkers,
    reflect,
    remove_hits_in_holes,
    wall_ranges,
    world_reflectances,
)
from lirs_envs.lidar.terrain_rays import TerrainMipmap, build_terrain_mipmap, terrain_ranges
from lirs_envs.walkers import PROP_GROUP, WALKER_GROUP, Walkers
from lirs_wct import ConfigError, HeightField, TriangleMesh, WallGrid, World, unknown_name
from lirs_wct.arrays import BoolArray, FloatArray, Int32Array, njit
from lirs_wct.contact.spec import RAY_GROUP, TERRAIN_GROUP

SLACK = 1e-4
"""Meters added to Embree's largest range: single precision at a kilometer."""


class Caster(ABC):
    """Geometry that beams can meet."""

    @abstractmethod
    def hits(
        self, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return ranges (n,) as `ranges` does, and (n,) reflectivities times cosines of the incidence."""

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) meters along unit directions (n, 3); inf where nothing is within `max_range`.

        The origin is (3,) of all rays, or (n, 3) of each; world frame, meters, finite.
        """
        return self.hits(origins, directions, max_range)[0]


class MeshCaster(Caster):
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
                "the lidar on a mesh with overhangs needs the package embreex: pip install 'lirs-wct[mesh]', "
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

    def hits(
        self, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return ranges and reflectances (see `Caster`)."""
        origins = origins - self._middle
        starts = np.empty(directions.shape, np.float32)
        starts[:] = origins
        reach = np.full(len(directions), min(max_range + SLACK, 1e30), np.float32)
        met = self._scene.run(starts, directions.astype(np.float32), dists=reach, output=True)
        ranges = np.empty(len(directions))
        starts_exact = np.broadcast_to(origins, directions.shape)
        _refine(self._vertices, self._faces, met["primID"], starts_exact, directions, max_range, ranges)
        a, b, c = self._vertices[self._faces[met["primID"]]].transpose(1, 0, 2)
        return ranges, reflect(GROUND, np.cross(b - a, c - a), directions)


@njit
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


@njit(forceinline=True)
def _plane_range(vertices: FloatArray, face: Int32Array, o: FloatArray, d: FloatArray) -> float:
    """Return the distance along a ray to a triangle's plane, within those of the corners along the ray.

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


class RayCaster(Caster):
    """Ranges from a point along rays to the nearest triangle or wall of a world."""

    def __init__(self, surface: HeightField, walls: WallGrid | None = None) -> None:
        self.terrain: TerrainMipmap = build_terrain_mipmap(surface)
        self.walls = NO_WALLS if walls is None else build_wall_cells(walls)

    def __deepcopy__(self, memo: dict[int, Any]) -> RayCaster:
        """Return the caster itself: it is a value, and copies of a simulation share it."""
        return self

    def cast(self, origin: ArrayLike, directions: ArrayLike, max_range: float = math.inf) -> FloatArray:
        """Return (n,) ranges in meters along unit directions (n, 3); inf where nothing is within `max_range`.

        The origin is (3,) of all rays, or (n, 3) of each; world frame, meters.

        Raises:
            ConfigError: an array has the wrong shape or a value that is not finite.
        """
        if not max_range >= 0:
            raise ConfigError(f"max_range must be at least 0 m, got {max_range}")
        return self.ranges(*_rays(origin, directions), float(max_range))

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) ranges of rays that are known to be legal (see `Caster`)."""
        ranges = np.full(len(directions), np.inf)
        rays = origins.reshape(-1, 3), directions, max_range, ranges
        if self.walls.distance.size:
            cast_rays(self.terrain, self.walls, *rays)
        else:  # the kernels of walls need not be compiled
            terrain_ranges(self.terrain, *rays)
        return ranges

    def hits(
        self, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return ranges and reflectances (see `Caster`)."""
        ranges = self.ranges(origins, directions, max_range)
        reflectances = np.empty_like(ranges)
        world_reflectances(self.terrain, self.walls, origins.reshape(-1, 3), directions, ranges, reflectances)
        return ranges, reflectances


@njit
def cast_rays(
    terrain: TerrainMipmap,
    walls: WallCells,
    origins: FloatArray,
    directions: FloatArray,
    max_range: float,
    ranges: FloatArray,
) -> None:
    """Fill `ranges` (n,) with the distance to the nearest wall or triangle; inf = none within `max_range`.

    All rays start at one origin (1, 3), or each at its own (n, 3).
    """
    wall_ranges(walls, origins, directions, max_range, ranges)
    if walls.hole.size == 0:
        terrain_ranges(terrain, origins, directions, max_range, ranges)
        return
    wall_range = ranges.copy()
    terrain_ranges(terrain, origins, directions, max_range, ranges)
    remove_hits_in_holes(walls, origins, directions, wall_range, ranges)


def mujoco_hits(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    origin: ArrayLike,
    directions: ArrayLike,
    max_range: float,
    *,
    groups: Collection[int] = (0, 1, 2),
) -> tuple[FloatArray, Int32Array, FloatArray]:
    """Return ranges (n,), geoms (n,) and normals (n, 3) of hits on MuJoCo's geoms of some groups.

    The data are those after `mj_forward` or a step, origin and directions those of `RayCaster.cast`. Hits
    beyond `max_range` have range inf, rays without a hit also geom -1.
    """
    if not set(groups) <= set(range(mujoco.mjNGROUP)):
        raise ConfigError(f"geom groups must be 0 to {mujoco.mjNGROUP - 1}, got {sorted(groups)}")
    o, d = _rays(origin, directions)
    n = len(d)
    mask = np.array([g in groups for g in range(mujoco.mjNGROUP)], dtype=np.uint8)
    geoms, distance, normals = np.full(n, -1, np.int32), np.empty(n), np.zeros((n, 3))
    seen = model, data
    if o.ndim == 2:
        for k in range(n):
            distance[k] = mujoco.mj_ray(*seen, o[k], d[k], mask, True, -1, geoms[k : k + 1], normals[k])
    elif n:
        flat = normals.reshape(-1)
        mujoco.mj_multiRay(*seen, o, d.ravel(), mask, True, -1, geoms, distance, flat, n, max_range)
    ranges = np.where((geoms >= 0) & (distance <= max_range), distance, np.inf)
    return ranges, geoms, normals


def _rays(origin: ArrayLike, directions: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return both as contiguous float64, checked."""
    o = np.ascontiguousarray(origin, dtype=np.float64)
    d = np.ascontiguousarray(directions, dtype=np.float64)
    if d.ndim != 2 or d.shape[1] != 3 or o.shape not in ((3,), d.shape):
        raise ConfigError(f"rays need an origin (3,) and directions (n, 3), got {o.shape} and {d.shape}")
    if not (np.isfinite(o).all() and np.isfinite(d).all()):
        raise ConfigError("origin and directions of rays must be finite")
    return o, d


Rays = Literal["builtin", "mujoco"]
RAYS: tuple[Rays, ...] = get_args(Rays)
"""Whose rays meet the world: the builtin ones, or MuJoCo's (for comparison; 20 to 10,000 times slower)."""


def resolve_rays(name: str) -> Rays:
    """Return the ray caster of a name."""
    for rays in RAYS:
        if name == rays:
            return rays
    raise unknown_name("rays", name, RAYS)


class GeomCaster(Caster):
    """MuJoCo's rays on groups of its geoms, in the present state."""

    def __init__(self, data: mujoco.MjData, groups: tuple[int, ...]) -> None:
        self._data, self._groups = data, groups
        model = data.model
        self._reflectivity = np.where(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX, WALL, GROUND)
        self._reflectivity[model.geom_group == PROP_GROUP] = PROP
        self._reflectivity[model.geom_group == WALKER_GROUP] = WALKER

    def hits(
        self, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return ranges and reflectances (see `Caster`)."""
        model = self._data.model
        # Poses of geoms are those before the last step; bringing them up to date does not change stepping.
        mujoco.mj_kinematics(model, self._data)
        rays = origins, directions, max_range
        ranges, geoms, normals = mujoco_hits(model, self._data, *rays, groups=self._groups)
        return ranges, self._reflectivity[geoms] * reflect(1.0, normals, directions)


class NearestCaster(Caster):
    """The nearer range of two casters."""

    def __init__(self, first: Caster, second: Caster) -> None:
        self._first, self._second = first, second

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) ranges (see `Caster`)."""
        rays = (origins, directions, max_range)
        nearest: FloatArray = np.minimum(self._first.ranges(*rays), self._second.ranges(*rays))
        return nearest

    def hits(
        self, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return ranges and reflectances (see `Caster`)."""
        rays = (origins, directions, max_range)
        first, second = self._first.hits(*rays), self._second.hits(*rays)
        nearer = first[0] <= second[0]
        return np.where(nearer, first[0], second[0]), np.where(nearer, first[1], second[1])


class WalkerCaster(Caster):
    """Caster of walkers on top of another caster.

    Attributes:
        met: (n,) which rays of the last call met a walker.

    Args:
        caster: caster of everything else; with MuJoCo's rays, of the walkers too.
        builtin: whether the builtin rays meet the walkers.
    """

    def __init__(self, caster: Caster, walkers: Walkers, *, builtin: bool) -> None:
        self._caster, self._walkers, self._builtin = caster, walkers, builtin
        self.met: BoolArray = np.zeros(0, np.bool_)

    def ranges(self, origins: FloatArray, directions: FloatArray, max_range: float) -> FloatArray:
        """Return (n,) ranges (see `Caster`)."""
        return self._meet(self._caster.ranges(origins, directions, max_range), origins, directions, max_range)

    def hits(
        self, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return ranges and reflectances (see `Caster`)."""
        ranges, reflectances = self._caster.hits(origins, directions, max_range)
        nearest = self._meet(ranges, origins, directions, max_range)
        if self._builtin and self.met.any():
            starts, beams = np.broadcast_to(origins, directions.shape)[self.met], directions[self.met]
            normals = capsule_normals(self._walkers.centers, starts + nearest[self.met, None] * beams)
            reflectances[self.met] = reflect(WALKER, normals, beams)
        return nearest, reflectances

    def _meet(
        self, ranges: FloatArray, origins: FloatArray, directions: FloatArray, max_range: float
    ) -> FloatArray:
        """Return the ranges with walkers; sets `met`."""
        self.met = np.empty(len(ranges), np.bool_)
        nearest = np.empty_like(ranges)
        meet_walkers(
            self._walkers.centers, origins.reshape(-1, 3), directions, max_range, ranges, nearest, self.met
        )
        return nearest if self._builtin else ranges


def make_caster(
    world: World, rays: Rays, props: bool, data: mujoco.MjData, walkers: Walkers | None = None
) -> Caster:
    """Return the caster of a world with its props and walkers, without the robot.

    MuJoCo's data serve props and its own rays.
    """
    caster: Caster
    groups = (PROP_GROUP,) if props else ()
    if rays == "mujoco":
        ground = RAY_GROUP if world.overhangs else TERRAIN_GROUP
        caster = GeomCaster(data, (*groups, ground) if walkers is None else (WALKER_GROUP, *groups, ground))
    else:
        caster = MeshCaster(world.mesh) if world.overhangs else RayCaster(world.surface, world.walls)
        caster = NearestCaster(caster, GeomCaster(data, groups)) if groups else caster
    return caster if walkers is None else WalkerCaster(caster, walkers, builtin=rays == "builtin")
