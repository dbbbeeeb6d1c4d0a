"""MuJoCo model of a world: ground, walls, contact geometry.

Row 0 of MuJoCo's height field is at -y, row 0 of ours is in the north; `HeightField.south_up` flips it.
MuJoCo scales heights to [0, 1] by their minimum and maximum. The geom stores both: the minimum as its z, the
relief as its elevation.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from lirs_wct.arrays import BoolArray
from lirs_wct.contact.contact_geometry import ContactGeometry, check_contact_geometry
from lirs_wct.contact.contact_grid import ContactGrid
from lirs_wct.contact.contact_parts import contact_parts
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.rectangles import merged_rectangles
from lirs_wct.geometry.walls import WallGrid
from lirs_wct.meshing.tiles import MUJOCO_FACES, split_tiles
from lirs_wct.world import World

TERRAIN_GROUP = 3
"""Geom group of ground and walls in a simulation; rays for robots and props exclude it."""
BASE = 1.0
"""Meters that the ground reaches below its lowest point; contacts push along the shorter direction, up."""
RAY_GROUP = 5
"""Geom group of a mesh with overhangs for MuJoCo's rays; no robot uses it."""
GROUND_COLOR = (0.62, 0.57, 0.48, 1.0)
WALL_COLOR = (0.45, 0.5, 0.55, 1.0)


def world_spec(
    world: World,
    *,
    contact: ContactGrid | None = None,
    robot: mujoco.MjSpec | None = None,
    contact_geometry: ContactGeometry = "hfield",
    ray_surface: bool = False,
    height_range: tuple[float, float] | None = None,
) -> mujoco.MjSpec:
    """Return the world as an MjSpec to compile.

    Args:
        world: ground and walls.
        contact: contact grid; default: the surface itself.
        robot: specification to which the world is added; its options and defaults stay unchanged.
        contact_geometry: geometry of contacts (see `CONTACT_GEOMETRIES`).
        ray_surface: whether to add the surface itself for MuJoCo's own rays if contacts use another geometry.
        height_range: lowest and highest height of the height field, meters; `write_heights` fills it in the
            compiled model. Default: the range of the ground.

    Raises:
        ConfigError: the terrain does not fit the world.
    """
    check_contact_geometry(contact_geometry, world)
    spec = robot if robot is not None else mujoco.MjSpec()
    spec.modelname = world.name
    surface = world.surface if contact is None else contact.heights(world.surface)
    _add_contact_geoms(spec, world, surface, contact_geometry, height_range)
    if contact_geometry == "mesh" or world.overhangs:
        _add_tiles(spec, world, RAY_GROUP if world.overhangs else TERRAIN_GROUP)
    elif ray_surface and (contact_geometry != "hfield" or surface.shape != world.surface.shape):
        _hide(spec)
        _add_ground(spec, world.surface, name="seen", contype=0, conaffinity=0)
    for geom in spec.worldbody.geoms:
        # The robot's defaults also apply here: equal priorities would mix the contact parameters of both.
        geom.priority = 0
    spec.worldbody.add_light(pos=(0, 0, 50), dir=(0.3, 0.2, -1), type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    return spec


def contact_spec(world: World, contact_geometry: ContactGeometry) -> mujoco.MjSpec:
    """Return only the geoms that are touched; the height field has no heights."""
    spec = mujoco.MjSpec()
    _add_contact_geoms(spec, world, world.surface, contact_geometry, heights=False)
    return spec


def _add_contact_geoms(
    spec: mujoco.MjSpec,
    world: World,
    surface: HeightField,
    contact_geometry: ContactGeometry,
    height_range: tuple[float, float] | None = None,
    heights: bool = True,
) -> None:
    walls = world.walls
    if contact_geometry in ("prisms", "convex"):
        _add_parts(spec, world, contact_geometry)
    elif walls is None or walls.hole is None:
        _add_ground(spec, surface, height_range=height_range, heights=heights)
    else:
        _add_boxes(spec, walls, walls.floor, (-BASE, 0.0), GROUND_COLOR)
    if walls is not None:
        _add_boxes(spec, walls, walls.solid, (0.0, walls.height), WALL_COLOR)


def _add_ground(
    spec: mujoco.MjSpec,
    surface: HeightField,
    name: str = "ground",
    height_range: tuple[float, float] | None = None,
    heights: bool = True,
    **options: int,
) -> None:
    west, south, east, north = surface.bounds
    low, relief = float(surface.z.min()), surface.relief
    if height_range is not None:
        low, relief = height_range[0], height_range[1] - height_range[0]
    half = ((east - west) / 2, (north - south) / 2)
    common = {
        "name": name,
        "pos": ((west + east) / 2, (south + north) / 2, low),
        "group": TERRAIN_GROUP,
        "rgba": GROUND_COLOR,
        **options,
    }
    if relief == 0.0:
        # A plane costs a contact test, a flat height field all the prisms under a wheel.
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(*half, 1.0), **common)
        return
    data = {}
    if heights:  # slow with millions of them
        data = dict(zip(("nrow", "ncol"), surface.shape, strict=True), userdata=surface.south_up.ravel())
    spec.add_hfield(name=name, size=(*half, relief, BASE), **data)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=name, **common)


def write_heights(model: mujoco.MjModel, surface: HeightField, height_range: tuple[float, float]) -> None:
    """Write heights into a compiled model's ground; its height range and nodes stay.

    The ground's bounding box, used in the first phase of collision detection, is compiled from the range.

    Raises:
        ConfigError: the surface has other nodes than the ground, or exceeds the range.
    """
    field, (low, high) = model.hfield("ground"), height_range
    shape = int(field.nrow[0]), int(field.ncol[0])
    if surface.shape != shape:
        raise ConfigError(f"heights must be {shape} nodes, those of the ground, got {surface.shape}")
    lowest, highest = float(surface.z.min()), float(surface.z.max())
    if not low <= lowest <= highest <= high:
        raise ConfigError(
            f"heights must be within {low:g} to {high:g} m, the height range, "
            f"got {lowest:.3f} to {highest:.3f}"
        )
    begin = int(model.hfield_adr[field.id])
    heights = model.hfield_data[begin : begin + surface.z.size].reshape(shape)
    np.subtract(surface.z[::-1], np.float32(low), out=heights)
    heights /= np.float32(high - low)


def _add_boxes(
    spec: mujoco.MjSpec,
    walls: WallGrid,
    cells: BoolArray,
    span: tuple[float, float],
    color: tuple[float, ...],
) -> None:
    """Add boxes to the world body; MuJoCo would update a separate body at every step."""
    half_yaw = walls.origin.yaw / 2
    quat = (math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw))
    low, high = span
    boxes = merged_rectangles(cells).reshape(-1, 4) * walls.resolution
    centers = walls.origin.apply((boxes[:, [1, 0]] + boxes[:, [3, 2]]) / 2)
    halves = (boxes[:, [3, 2]] - boxes[:, [1, 0]]) / 2
    for (x, y), (hx, hy) in zip(centers.tolist(), halves.tolist(), strict=True):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, (low + high) / 2),
            size=(hx, hy, (high - low) / 2),
            quat=quat,
            group=TERRAIN_GROUP,
            rgba=color,
        )
    # With sleeping enabled MuJoCo skips static geoms: 2,372 boxes cost 5 us a step instead of 19.
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)


def _add_parts(spec: mujoco.MjSpec, world: World, contact_geometry: ContactGeometry) -> None:
    """Add each convex part as a mesh; MuJoCo's contact uses its hull, which equals the part."""
    for k, corners in enumerate(contact_parts(world, contact_geometry)):
        name = f"ground{k}"
        spec.add_mesh(name=name, uservert=corners.ravel())
        spec.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, group=TERRAIN_GROUP, rgba=GROUND_COLOR
        )
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)


def _hide(spec: mujoco.MjSpec) -> None:
    """Make the contact geoms invisible to cameras and to MuJoCo's rays."""
    for geom in spec.worldbody.geoms:
        if geom.group == TERRAIN_GROUP:
            geom.rgba = (*geom.rgba[:3], 0.0)


def _add_tiles(spec: mujoco.MjSpec, world: World, group: int) -> None:
    """Add the world's mesh as visible geoms without contact; contact geoms become invisible."""
    _hide(spec)
    for k, tile in enumerate(split_tiles(world.mesh, aim=MUJOCO_FACES // 2)):
        name = f"seen{k}"
        spec.add_mesh(
            name=name,
            uservert=tile.vertices.ravel(),
            userface=tile.faces.ravel(),
            # A tile is open: it has no volume to take an inertia from.
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            contype=0,
            conaffinity=0,
            group=group,
            rgba=GROUND_COLOR,
        )
