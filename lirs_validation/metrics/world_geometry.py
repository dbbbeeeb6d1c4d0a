"""World geometry for metrics: points near obstacles, and the distance of mesh and surface."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lirs_wct import HeightField, TriangleMesh, WallGrid, World
from lirs_wct.arrays import BoolArray, FloatArray, njit
from lirs_wct.geometry.mesh import rasterize_heights

STEEP = math.radians(45)
"""Faces steeper than this are obstacles, radians."""


def near_obstacle(
    points: FloatArray, surface: HeightField, walls: WallGrid | None, distance: float, steep: float = STEEP
) -> BoolArray:
    """Return (n,) whether points (n, 2) are near an obstacle.

    An obstacle is a steep face's footprint or a wall cell.

    Args:
        points: world frame, meters.
        surface: the ground; each of its cells is two triangles.
        walls: wall cells, or None.
        distance: meters in the plane, 0 inside the footprint.
        steep: a face counts above this angle, radians.
    """
    xy = np.ascontiguousarray(points, dtype=np.float64)
    near: BoolArray = _near_steep(
        xy, surface.south_up, surface.cell, surface.origin, distance, math.tan(steep)
    )
    if walls is not None:
        local = walls.origin.inverse().apply(xy)
        near |= _near_wall(local, walls.solid, walls.resolution, distance)
    return near


@njit
def _near_steep(
    points: FloatArray, z: Any, cell: Any, origin: Any, distance: float, rise: float
) -> BoolArray:
    """Search the cells in a square around each point.

    Half side `distance`; z has row 0 = south.
    """
    rows, cols = z.shape
    cx, cy = cell
    near = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        # In meters from the south-west node.
        x, y = points[k, 0] - origin[0], points[k, 1] - origin[1]
        # A cell holds both of its edges: a point on the line between two is on either.
        i0, i1 = max(0, math.ceil((x - distance) / cx) - 1), min(cols - 2, math.floor((x + distance) / cx))
        j0, j1 = max(0, math.ceil((y - distance) / cy) - 1), min(rows - 2, math.floor((y + distance) / cy))
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                if near[k]:
                    break
                sw, se = float(z[j, i]), float(z[j, i + 1])
                nw, ne = float(z[j + 1, i]), float(z[j + 1, i + 1])
                west, south = i * cx, j * cy
                east, north = west + cx, south + cy
                if math.hypot((se - sw) / cx, (ne - se) / cy) > rise:
                    near[k] = _to_triangle(x, y, west, south, east, south, east, north) <= distance
                if not near[k] and math.hypot((ne - nw) / cx, (nw - sw) / cy) > rise:
                    near[k] = _to_triangle(x, y, west, south, east, north, west, north) <= distance
    return near


@njit
def _near_wall(points: FloatArray, solid: BoolArray, resolution: float, distance: float) -> BoolArray:
    """Search the wall cells round points given in the wall grid's frame."""
    rows, cols = solid.shape
    near = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        i0, i1 = math.ceil((x - distance) / resolution) - 1, math.floor((x + distance) / resolution)
        j0, j1 = math.ceil((y - distance) / resolution) - 1, math.floor((y + distance) / resolution)
        for j in range(max(0, j0), min(rows - 1, j1) + 1):
            for i in range(max(0, i0), min(cols - 1, i1) + 1):
                if solid[j, i]:
                    dx = max(i * resolution - x, 0.0, x - (i + 1) * resolution)
                    dy = max(j * resolution - y, 0.0, y - (j + 1) * resolution)
                    near[k] |= math.hypot(dx, dy) <= distance
    return near


@njit
def _to_triangle(
    x: float, y: float, ax: float, ay: float, bx: float, by: float, cx: float, cy: float
) -> float:
    """Return the distance of a point to a triangle given counter-clockwise; 0 inside."""
    inside = (
        (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0
        and (cx - bx) * (y - by) - (cy - by) * (x - bx) >= 0
        and (ax - cx) * (y - cy) - (ay - cy) * (x - cx) >= 0
    )
    if inside:
        return 0.0
    nearest: float = min(
        _to_segment(x, y, ax, ay, bx, by),
        _to_segment(x, y, bx, by, cx, cy),
        _to_segment(x, y, cx, cy, ax, ay),
    )
    return nearest


@njit
def _to_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the distance of a point to a segment."""
    dx, dy = bx - ax, by - ay
    t = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
    t = min(1.0, max(0.0, t))
    return math.hypot(x - ax - t * dx, y - ay - t * dy)


def mesh_error(world: World, mesh: TriangleMesh | None = None) -> float:
    """Return the largest vertical error of the world's mesh, or another, at the nodes, meters."""
    surface = world.surface
    chosen = world.mesh if mesh is None else mesh
    top = rasterize_heights(chosen, (*surface.origin, *surface.cell), surface.shape)
    top -= surface.z[::-1]
    return float(np.nanmax(np.abs(top, out=top))) if np.isfinite(top).any() else 0.0
