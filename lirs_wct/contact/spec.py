"""World as a MuJoCo specification: ground and walls as contact geometry on a contact grid.

Row 0 of MuJoCo's height field is at -y, row 0 of ours is in the north; `HeightField.south_up` flips it.
MuJoCo scales heights to [0, 1] by their minimum and maximum. The geom stores both: the minimum as its z, the
relief as its elevation.

The contact grid is the coarsest height field for wheels whose deviation from the surface is bounded. MuJoCo
tests every prism of a height field under a geom's bounding box. Half the spacing therefore costs up to four
times as much. The laser still sees the surface itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import mujoco
import numpy as np

from lirs_wct.contact import CONTACT_GEOMETRIES, ContactGeometry
from lirs_wct.contact.parts import convex_parts, prisms
from lirs_wct.errors import ConfigError, require_known
from lirs_wct.geometry import BoolArray, Float32Array, HeightField, WallGrid, njit
from lirs_wct.geometry.mesh import MUJOCO_FACES, split_tiles
from lirs_wct.meshing.walls import merged_rectangles
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
        world: world of the ground and its walls.
        contact: contact grid; default: the surface itself.
        robot: specification to which the world is added; its options and defaults stay unchanged.
        contact_geometry: geometry of contacts (see `CONTACT_GEOMETRIES`).
        ray_surface: whether to add the surface itself for MuJoCo's own rays if contacts use another geometry.
        height_range: lowest and highest height of the height field, meters; `write_heights` fills it in the
            compiled model. Default: the range of the ground.
    """
    check_contact_geometry(contact_geometry, world)
    spec = robot if robot is not None else mujoco.MjSpec()
    spec.modelname = world.name
    surface = world.surface if contact is None else contact.heights(world.surface)
    _add_contact_geoms(spec, world, surface, contact_geometry, height_range)
    if contact_geometry == "mesh" or world.overhangs:
        _hide(spec)
        group = RAY_GROUP if world.overhangs else TERRAIN_GROUP
        for k, tile in enumerate(split_tiles(world.mesh, aim=MUJOCO_FACES // 2)):
            corners = {"uservert": tile.vertices.ravel(), "userface": tile.faces.ravel()}
            # A tile is open: it has no volume to take an inertia from.
            shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            mesh = _add_mesh(spec, f"seen{k}", group, **corners, inertia=shell)
            mesh.contype = mesh.conaffinity = 0
    elif ray_surface and (contact_geometry != "hfield" or surface.shape != world.surface.shape):
        _hide(spec)
        _add_ground(spec, world.surface, name="seen", contype=0, conaffinity=0)
    for geom in spec.worldbody.geoms:
        # The robot's defaults also apply here: equal priorities would mix the contact parameters of both.
        geom.priority = 0
    spec.worldbody.add_light(pos=(0, 0, 50), dir=(0.3, 0.2, -1), type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    return spec


def check_contact_geometry(geometry: str, world: World) -> None:
    """Check that a contact geometry fits a world."""
    require_known("terrain for MuJoCo", geometry, CONTACT_GEOMETRIES)
    if world.walls is not None and geometry in ("prisms", "convex"):
        raise ConfigError(
            f"{world.name}: a laser map's walls are convex boxes already; legal terrains: hfield, mesh"
        )
    if world.overhangs and geometry != "convex":
        raise ConfigError(f"{world.name}: overhangs need the terrain convex (--terrain), got {geometry}")
    if geometry == "convex" and world.solid is None:
        raise ConfigError(f"{world.name}: terrain convex is for closed meshes; take hfield, mesh or prisms")


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
        parts = prisms(world) if contact_geometry == "prisms" else convex_parts(world.mesh)
        for k, corners in enumerate(parts):  # each as a mesh, which equals its hull
            _add_mesh(spec, f"ground{k}", TERRAIN_GROUP, uservert=corners.ravel())
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
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


def _add_mesh(spec: mujoco.MjSpec, name: str, group: int, **mesh: Any) -> mujoco.MjsGeom:
    """Add a mesh and its geom; return the geom."""
    spec.add_mesh(name=name, **mesh)
    kind = mujoco.mjtGeom.mjGEOM_MESH
    return spec.worldbody.add_geom(name=name, type=kind, meshname=name, group=group, rgba=GROUND_COLOR)


def _hide(spec: mujoco.MjSpec) -> None:
    """Make the contact geoms invisible to cameras and to MuJoCo's rays."""
    for geom in spec.worldbody.geoms:
        if geom.group == TERRAIN_GROUP:
            geom.rgba = (*geom.rgba[:3], 0.0)


VERTICAL = 0.01
"""Largest vertical deviation at nodes that touch no steep triangle, meters."""
HORIZONTAL, MATCH = 0.5, 0.02
"""Distance, contact cells along each axis, within which the contact grid must reach the height of a steep
node, and tolerance of that height, meters; at the foot of a wall the ground itself rises by so much."""
STEEP = math.radians(45)
"""Slope from which a triangle counts as steep, radians."""
MAX_CELL = 0.5
"""Largest contact cell, meters; larger cells save no time."""


@dataclass(frozen=True, kw_only=True)
class ContactGrid:
    """Spacing, budget and measured deviation of a contact grid.

    The deviation is measured at every node of the surface.

    Attributes:
        stride: cells of the surface in a contact cell, along each axis; 1 = the surface itself.
        cell: spacing of the contact grid's nodes, meters.
        vertical_budget: meters (see `VERTICAL`).
        horizontal_budget: meters, half a contact cell.
        match_budget: meters, the height's tolerance at the horizontal deviation.
        vertical: largest vertical deviation where the slope is under 45 deg, meters.
        horizontal: largest horizontal deviation along an axis on steeper faces, meters.
        nodes: number of nodes compared.
    """

    stride: int
    cell: tuple[float, float]
    vertical_budget: float
    horizontal_budget: float
    match_budget: float
    vertical: float
    horizontal: float
    nodes: int

    def heights(self, surface: HeightField) -> HeightField:
        """Return the heights of the contact grid of its surface.

        The grid begins at the south-west node. If the stride does not divide the surface's cells, the last
        row and column lie beyond the border, on the straight line through the border's node.
        """
        return HeightField(
            np.ascontiguousarray(_coarse(surface.south_up, self.stride)[::-1]), self.cell, surface.origin
        )


def contact_grid(surface: HeightField) -> ContactGrid:
    """Return the coarsest grid within the limits of deviation, by whole cells of the surface."""
    z = surface.south_up
    steep = steep_nodes(z, surface.cell, STEEP)
    largest = min(int(MAX_CELL / max(surface.cell)), min(z.shape) - 1)
    for stride in range(max(largest, 1), 1, -1):
        found = _measure_deviation(z, steep, stride)
        if found is not None:
            return _figures(surface, stride, *found)
    return surface_itself(surface)


def surface_itself(surface: HeightField) -> ContactGrid:
    """Return the contact grid that equals the surface, node by node."""
    return _figures(surface, 1, 0.0, 0.0)


def steep_nodes(z: Float32Array, cell: tuple[float, float], steep: float) -> BoolArray:
    """Return (rows, cols) whether a node, row 0 = south, belongs to a steep triangle.

    A triangle is steep from the angle `steep`, radians.
    """
    sw, se, nw, ne = z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]
    limit = math.tan(steep)
    below = np.hypot((se - sw) / cell[0], (ne - se) / cell[1]) >= limit
    above = np.hypot((ne - nw) / cell[0], (nw - sw) / cell[1]) >= limit
    mask = np.zeros(z.shape, np.bool_)
    mask[:-1, :-1] |= below | above
    mask[1:, 1:] |= below | above
    mask[:-1, 1:] |= below
    mask[1:, :-1] |= above
    return mask


def _figures(surface: HeightField, stride: int, vertical: float, cells: float) -> ContactGrid:
    cell = (stride * surface.cell[0], stride * surface.cell[1])
    return ContactGrid(
        stride=stride,
        cell=cell,
        vertical_budget=VERTICAL,
        horizontal_budget=HORIZONTAL * max(cell),
        match_budget=MATCH,
        vertical=vertical,
        horizontal=cells * max(surface.cell),
        nodes=surface.z.size,
    )


def _measure_deviation(z: Float32Array, steep: BoolArray, stride: int) -> tuple[float, float] | None:
    """Return the vertical (meters) and horizontal (cells) deviation; None if above the limits."""
    contact = np.empty_like(z)
    vertical = float(_resample(_coarse(z, stride), stride, z, steep, VERTICAL, contact))
    if vertical > VERTICAL:
        return None
    # On a path between two nodes a continuous surface has every height between theirs. Thus it reaches the
    # node's height in its window if that lies between the window's lowest and highest height.
    far = (np.abs(contact - z) > VERTICAL).astype(np.uint8)
    for cells in range(int(HORIZONTAL * stride) + 1):
        window = np.ones((2 * cells + 1, 2 * cells + 1), np.uint8)
        low, high = cv2.erode(contact, window), cv2.dilate(contact, window)
        far &= (z < low - MATCH) | (z > high + MATCH)
        if not far.any():
            return vertical, float(cells)
    return None


def _coarse(z: Float32Array, stride: int) -> Float32Array:
    """Return every stride-th node from the south-west.

    If the stride does not divide the cells, a last node lies beyond the border.
    """
    for axis in (0, 1):
        z = np.moveaxis(z, axis, 0)
        whole, rest = divmod(len(z) - 1, stride)
        nodes = z[: whole * stride + 1 : stride]
        if rest:
            beyond = nodes[-1] + (z[-1] - nodes[-1]) * np.float32(stride / rest)
            nodes = np.concatenate((nodes, beyond[None]))
        z = np.moveaxis(nodes, 0, axis)
    return np.ascontiguousarray(z)


@njit
def _resample(
    coarse: Float32Array, stride: int, z: Float32Array, steep: BoolArray, limit: float, contact: Float32Array
) -> float:
    """Fill `contact` with the coarse grid at every node; return the largest deviation.

    The deviation counts at nodes that are not steep. The kernel stops at the first one above `limit`.
    """
    worst = 0.0
    for r in range(z.shape[0]):
        j = min(r // stride, coarse.shape[0] - 2)
        v = (r - j * stride) / stride
        for c in range(z.shape[1]):
            i = min(c // stride, coarse.shape[1] - 2)
            u = (c - i * stride) / stride
            sw, ne = coarse[j, i], coarse[j + 1, i + 1]
            if u >= v:
                se = coarse[j, i + 1]
                height = sw + u * (se - sw) + v * (ne - se)
            else:
                nw = coarse[j + 1, i]
                height = sw + u * (ne - nw) + v * (nw - sw)
            contact[r, c] = height
            if not steep[r, c]:
                deviation = abs(height - z[r, c])
                worst = max(worst, deviation)
                if deviation > limit:
                    return float(worst)
    return float(worst)
