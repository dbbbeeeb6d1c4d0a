"""World geometry: points near obstacles against plain geometry, and the error of a mesh."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_validation.metrics.world_geometry import mesh_error, near_obstacle
from lirs_wct.geometry.grid import WallGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import MeshGround, Terrain
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.world import World

FLAT = HeightField(np.zeros((2, 2), np.float32), (10.0, 10.0), (-5.0, -5.0))
CLOSE = 1e-7
"""Where the distance is as good as the limit, rounding decides, meters."""
seeds = st.integers(0, 2**32 - 1)


def to_polygon(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return (n,) distances to a convex polygon (m, 2), counter-clockwise; 0 inside."""
    edges = np.roll(corners, -1, axis=0) - corners
    offset = points[:, None] - corners[None]
    left = edges[None, :, 0] * offset[..., 1] - edges[None, :, 1] * offset[..., 0] >= 0
    along = np.clip((offset * edges).sum(axis=2) / (edges**2).sum(axis=1), 0, 1)
    distance = np.linalg.norm(offset - along[..., None] * edges, axis=2).min(axis=1)
    return np.where(left.all(axis=1), 0.0, distance)


def to_steep(points: np.ndarray, field: HeightField, steep: float) -> np.ndarray:
    """Return (n,) distances to the nearest face above an angle, by the normal of every triangle."""
    (cx, cy), (x0, y0), rows = field.cell, field.origin, field.shape[0]
    nearest = np.full(len(points), np.inf)
    for j, i in np.ndindex(rows - 1, field.shape[1] - 1):
        sw, se, ne, nw = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
        for triangle in ((sw, se, ne), (sw, ne, nw)):
            v = np.array([(x0 + c * cx, y0 + r * cy, field.z[rows - 1 - r, c]) for c, r in triangle])
            normal = np.cross(v[1] - v[0], v[2] - v[0])
            if math.atan2(math.hypot(normal[0], normal[1]), normal[2]) > steep:
                nearest = np.minimum(nearest, to_polygon(points, v[:, :2]))
    return nearest


def to_walls(points: np.ndarray, walls: WallGrid) -> np.ndarray:
    """Return (n,) distances to the nearest wall cell, each a square turned with its map."""
    nearest, r = np.full(len(points), np.inf), walls.resolution
    for row, col in np.argwhere(walls.solid):
        square = np.array([(col, row), (col + 1, row), (col + 1, row + 1), (col, row + 1)]) * r
        nearest = np.minimum(nearest, to_polygon(points, walls.origin.apply(square)))
    return nearest


def check(near: np.ndarray, distance: np.ndarray, limit: float) -> None:
    clear = np.abs(distance - limit) > CLOSE
    np.testing.assert_array_equal(near[clear], (distance <= limit)[clear])


@given(seeds)
@settings(max_examples=60)
def test_steep_faces_anywhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cell = tuple(rng.uniform(0.05, 2.0, 2).tolist())
    origin = tuple(rng.uniform(-30, 30, 2).tolist())
    rows, cols = rng.integers(2, 7, 2).tolist()
    z = rng.uniform(-4, 1, (rows, cols)) * (rng.random((rows, cols)) < 0.4)
    field = HeightField(z.astype(np.float32), cell, origin)
    steep, limit = float(rng.uniform(0.2, 1.4)), float(rng.choice((0.0, 0.1, rng.uniform(0, 2))))
    west, south, east, north = field.bounds
    points = rng.uniform((west - 1, south - 1), (east + 1, north + 1), (40, 2))
    check(near_obstacle(points, field, None, limit, steep), to_steep(points, field, steep), limit)


@given(seeds)
@settings(max_examples=60)
def test_walls_anywhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 8, 2).tolist())
    origin = Pose2(*rng.uniform((-40, -40, -3.1), (40, 40, 3.1)).tolist())
    walls = WallGrid(rng.random(shape) < 0.2, float(rng.uniform(0.03, 1.5)), origin)
    limit = float(rng.choice((0.0, 0.1, rng.uniform(0, 2))))
    low, high = walls.corners.min(axis=0) - 1, walls.corners.max(axis=0) + 1
    points = rng.uniform(low, high, (40, 2))
    check(near_obstacle(points, FLAT, walls, limit), to_walls(points, walls), limit)


def test_a_distance_that_is_just_met_is_near() -> None:
    # Every number is a sum of powers of two: nothing is rounded.
    z = np.zeros((3, 4), np.float32)
    z[:, 2:] = 4.0  # a face from x = 1.5 to 1.75 (cells of 0.25 by 0.5)
    field = HeightField(z, (0.25, 0.5), (1.25, -3.0))
    x = np.array([1.5 - 0.125, 1.5 - 0.1328125, 1.5, 1.75, 1.75 + 0.125, 1.75 + 0.1328125])
    near = near_obstacle(np.column_stack((x, np.full(6, -2.5))), field, None, 0.125)
    assert near.tolist() == [True, False, True, True, True, False]
    walls = WallGrid(np.array([[False, True, False]]), 0.25, Pose2(-8.0, 4.0))
    x = np.array([-7.75 - 0.125, -7.75 - 0.1328125, -7.5 + 0.125, -7.5 + 0.1328125, -7.625])
    near = near_obstacle(np.column_stack((x, np.full(5, 4.125))), FLAT, walls, 0.125)
    assert near.tolist() == [True, False, True, False, True]


@pytest.mark.parametrize(("north", "east"), [(0, 1), (1, 0)])
def test_a_slope_of_just_the_limit_is_no_obstacle(north: int, east: int) -> None:
    for rise, expected in ((0.25, False), (0.25 + 2**-20, True)):
        z = np.add.outer(north * np.arange(3)[::-1] * 4, east * np.arange(3) * 2).astype(np.float32) * rise
        field = HeightField(z.astype(np.float32), (2.0, 4.0), (-4.0, -8.0))
        steep = math.atan(0.25)
        assert math.tan(steep) == 0.25
        assert near_obstacle(np.array([[-1.0, -3.0]]), field, None, 0.5, steep).tolist() == [expected]


def test_the_largest_distance_up_or_down() -> None:
    z = np.random.default_rng(2).uniform(0, 1, (5, 8)).astype(np.float32)
    surface = HeightField(z, (0.5, 0.25), (3.0, -7.0))
    world = World("hill", Terrain(surface))
    assert mesh_error(world) == pytest.approx(0.0, abs=1e-6)
    for shift in (0.125, -0.25):
        moved = solid_mesh(surface)
        node = int(
            np.argmin(np.linalg.norm(moved.vertices - (4.0, -6.5, surface.height_at(4.0, -6.5)), axis=1))
        )
        vertices = moved.vertices.copy()
        vertices[node, 2] += shift
        bent = MeshGround(surface, TriangleMesh(vertices, moved.faces))
        assert mesh_error(replace(world, ground=bent)) == pytest.approx(abs(shift), abs=1e-6)
