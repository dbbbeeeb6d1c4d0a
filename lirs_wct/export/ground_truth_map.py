"""Ground-truth map of a world for a planar lidar of a given height."""

from __future__ import annotations

import math

import cv2
import numpy as np

from lirs_wct.contact.spec import steep_nodes
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import BoolArray, FloatArray, HeightField, OccupancyGrid, Pose2
from lirs_wct.geometry.mesh import TriangleMesh, rasterize_heights
from lirs_wct.world import World

ROBOT_HEIGHT = 0.3
"""Default height of the map above the ground, meters."""
RESOLUTION = 0.05
"""Cell size, meters; coarser if a world has more than `CELLS` cells along a side."""
CELLS = 4000
STEEP = math.radians(45)
"""Slope of a face above which it counts as a wall, as in `map.false_occupied`, radians."""
TOUCHING = 1e-4
"""Depth by which an object on the ground may reach into it, meters."""


def ground_truth_map(world: World, height: float = ROBOT_HEIGHT) -> OccupancyGrid:
    """Return the obstacles of a robot whose lidar has a height: occupied, free, unknown (NaN).

    In a laser map, wall cells at least as high as the lidar and holes are occupied. In other worlds, faces
    steeper than 45 deg that rise by at least the height, ceilings lower than the height, and nodes without
    ground are occupied.
    """
    if not 0 < height < math.inf:
        raise ConfigError(f"height of a map must be a finite number above 0 m, got {height}")
    if world.walls is not None:
        walls, truth = world.walls, world.truth
        p = np.where(walls.solid & (walls.height >= height), 1.0, 0.0)
        if truth is not None:
            p[~truth.known & ~walls.solid] = np.nan
        if walls.hole is not None:
            p[walls.hole] = 1.0
        return OccupancyGrid.from_probability(p, walls.resolution, walls.origin)
    ground, blocked = world.surface, np.zeros(world.surface.shape, np.bool_)
    if world.overhangs:
        assert world.solid is not None
        ground, low = _under_roofs(world.solid, world.surface, height)
        blocked |= low
    if world.no_ground is not None:
        blocked |= world.no_ground
    blocked |= tall_faces(ground, height)[::-1]
    return _to_grid(ground, blocked)


def tall_faces(surface: HeightField, height: float) -> BoolArray:
    """Return (rows, cols) whether nodes are on tall steep faces; row 0 = south.

    Connected faces of over 45 deg are tall if together they rise by at least `height` meters.
    """
    z = surface.south_up
    steep = steep_nodes(z, surface.cell, STEEP)
    count, labels = cv2.connectedComponents(steep.astype(np.uint8), connectivity=8)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, labels.ravel(), z.ravel())
    np.maximum.at(high, labels.ravel(), z.ravel())
    tall = high - low >= height
    tall[0] = False
    return np.asarray(tall[labels])


def _under_roofs(solid: TriangleMesh, surface: HeightField, height: float) -> tuple[HeightField, BoolArray]:
    """Return the lowest ground below overhangs, and the nodes below a low ceiling."""
    up = solid.face_normals[:, 2]
    ground = _lowest(solid, up > 1e-9, surface)
    lost = np.isnan(ground)
    ground[lost] = surface.south_up[lost]
    field = HeightField(np.ascontiguousarray(ground[::-1].astype(np.float32)), surface.cell, surface.origin)
    middle = solid.vertices[solid.faces].mean(axis=1)
    under = field.height_at(middle[:, 0], middle[:, 1])
    roof = _lowest(solid, (up < -1e-9) & (middle[:, 2] >= under - TOUCHING), surface)
    return field, (np.nan_to_num(roof - ground, nan=np.inf) < height)[::-1]


def _lowest(solid: TriangleMesh, chosen: BoolArray, surface: HeightField) -> FloatArray:
    """Return (rows, cols) heights of the lowest chosen faces; row 0 = south.

    NaN where no chosen face is.
    """
    if not chosen.any():
        return np.full(surface.shape, np.nan)
    upside_down = TriangleMesh(solid.vertices * np.array((1.0, 1.0, -1.0)), solid.faces[chosen])
    return -rasterize_heights(upside_down, (*surface.origin, *surface.cell), surface.shape)


def _to_grid(surface: HeightField, blocked: BoolArray) -> OccupancyGrid:
    """Return a grid over the surface whose cells with a blocked node are occupied."""
    (width, depth), (west, south) = surface.size, surface.origin
    resolution = max(RESOLUTION, max(width, depth) / CELLS)
    shape = (max(1, round(depth / resolution)), max(1, round(width / resolution)))
    rows, cols = (
        np.clip(((np.arange(n) + 0.5) * resolution / step).round().astype(int), 0, count - 1)
        for n, step, count in zip(shape, surface.cell[::-1], surface.shape, strict=True)
    )
    south_up = blocked[::-1]
    p = south_up[np.ix_(rows, cols)].astype(np.float64)
    at = np.argwhere(south_up) * np.array(surface.cell[::-1]) / resolution
    cells = np.minimum(at.astype(int), np.array(shape) - 1)
    p[cells[:, 0], cells[:, 1]] = 1.0
    return OccupancyGrid.from_probability(p, resolution, Pose2(west, south))
