"""World geometry: points near obstacles against plain geometry, errors of meshes, walls in sight."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_envs.robots.robot import make_robot
from lirs_validation.metrics.map import near_obstacle, observed_support
from lirs_validation.metrics.world_geometry import POSES, ScanSupport, mesh_error, scan_support, standing_on
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan
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


HUSKY = make_robot("husky")


def terrain(z: np.ndarray, cell: float = 0.1) -> World:
    field = HeightField.centered(z.astype(np.float32), (cell, cell))
    return World("made", Terrain(field), spawn_poses=(Pose2(),))


def axes(n: int = 401) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the nodes, row 0 = north."""
    axis = (np.arange(n) - n // 2) * 0.1
    return np.meshgrid(axis, -axis)


def test_level_ground_returns_nothing() -> None:
    found = scan_support(terrain(np.zeros((401, 401))), HUSKY)
    assert (found.wall_median, found.ground_median, found.wall_share) == (0.0, 0.0, 0.0)
    assert found.poses == POSES
    assert found.expectation == "walls on 0 of 541 beams: too few for planar mapping"


def test_the_robot_stands_as_the_ground_lies() -> None:
    x, y = axes()
    world = terrain(0.2 * x + 0.1 * y)
    T = standing_on(world, HUSKY, Pose2(1.0, 2.0, math.pi / 2))
    ahead, left = T.rotation[:, 0], T.rotation[:, 1]
    assert ahead[2] / math.hypot(*ahead[:2]) == pytest.approx(0.1, abs=0.01), "north rises by 0.1"
    assert left[2] / math.hypot(*left[:2]) == pytest.approx(-0.2, abs=0.01), "west falls by 0.2"
    assert T.z == pytest.approx(0.2 * 1.0 + 0.1 * 2.0 + HUSKY.base_height, abs=1e-6)
    flying = standing_on(world, make_robot("quadrotor"), Pose2(1.0, 2.0, 0.3))
    assert (flying.roll, flying.pitch) == pytest.approx((0.0, 0.0))
    assert flying.z == pytest.approx(0.4 + make_robot("quadrotor").base_height, abs=1e-6)


@pytest.mark.parametrize(
    ("least", "median", "expected"),
    [
        (5.0, 5.0, "walls on 5 of 100 beams: enough for planar mapping nearly everywhere"),
        (4.0, 5.0, "walls on 4 to 5 of 100 beams: too few for planar mapping in some places"),
        (4.0, 4.0, "walls on 4 of 100 beams: too few for planar mapping"),
    ],
)
def test_a_twentieth_of_the_beams_is_enough(least: float, median: float, expected: str) -> None:
    found = ScanSupport(robot="husky", beams=100, poses=1, wall_p10=least, wall_median=median)
    assert found.expectation == expected


def test_a_pit_with_steep_walls_is_all_walls_and_one_with_gentle_ones_all_ground() -> None:
    x, y = axes()
    rim = np.maximum(np.abs(x), np.abs(y)) - 6.0
    steep = scan_support(terrain(np.clip(rim, 0, 0.2) * 20), HUSKY)
    gentle = scan_support(terrain(np.maximum(rim, 0) * math.tan(math.radians(35))), HUSKY)
    assert steep.wall_share > 0.99
    assert gentle.wall_share < 0.01
    assert gentle.ground_p10 == gentle.beams


def test_ground_that_the_start_does_not_reach_does_not_count() -> None:
    """A race track in an open field was expected to show no walls."""
    x, y = axes()
    ring = np.abs(np.maximum(np.abs(x), np.abs(y)) - 4.0) < 0.3
    world = terrain(np.where(ring, 3.0, 0.0))
    found = scan_support(world, HUSKY)
    assert found.wall_p10 == found.beams
    outside = replace(world, spawn_poses=(Pose2(15.0, 0.0),))
    assert scan_support(outside, HUSKY).wall_median < 0.3 * found.beams


def test_the_hits_of_a_wall_are_those_within_its_angle_and_the_range() -> None:
    """A wall 40 m long all along one side: from y it spans an angle that is computed here by hand."""
    _, y = axes()
    world = terrain(np.where(y > 19.0, 3.0, 0.0))
    found = scan_support(world, HUSKY)
    rng = np.random.default_rng(0)
    expected = []
    for px, py, yaw in zip(
        rng.uniform(-19, 19, 4000), rng.uniform(-19, 18, 4000), rng.uniform(0, 2 * math.pi, 4000), strict=True
    ):
        bearing = yaw + np.radians(np.linspace(-135, 135, found.beams))
        away = (19.0 - py) / np.maximum(np.sin(bearing), 1e-9)
        along = px + away * np.cos(bearing)
        expected.append(int(((np.sin(bearing) > 0) & (away < 20.0) & (np.abs(along) < 20.0)).sum()))
    assert found.wall_median == pytest.approx(np.median(expected), rel=0.15, abs=5)


def test_a_robot_that_fits_nowhere_has_no_forecast() -> None:
    x, _ = axes()
    found = scan_support(terrain(x * math.tan(math.radians(40))), HUSKY)
    assert asdict(found) == {"robot": "husky", "beams": 541, "poses": 0} | dict.fromkeys(
        ("wall_median", "wall_p10", "ground_median", "ground_p10", "wall_share"), 0.0
    )
    assert found.expectation == "the robot can stand nowhere"


def test_recorded_hits_are_of_walls_where_they_end_at_steep_faces() -> None:
    x, _ = axes()
    world = terrain(np.where(np.abs(x) > 5.0, 3.0, 0.0))  # walls 5 m to the west and to the east
    angles = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    ranges = np.minimum(5.05 / np.maximum(np.abs(np.cos(angles)), 1e-9), 10.0)
    ranges[ranges >= 10.0] = np.inf
    scan = LaserScan(ranges.astype(np.float32), -math.pi, 2 * math.pi / 360, 0.1, 20.0, 0.0)
    turned = Pose3.from_pose2(Pose2(0.0, 1.0, math.pi), 0.5)
    found = observed_support(world, [scan, scan], [Pose3(z=0.5), turned])
    hits = float(scan.hits.sum())
    for aside, walls in ((0.09, True), (0.11, False)):  # of the eastern face, which is at x = 5 ... 5.1
        short = LaserScan(np.array([5.0 - aside], np.float32), 0.0, 0.1, 0.1, 20.0, 0.0)
        assert (observed_support(world, [short], [Pose3(z=0.5)])["walls_median"] == 1.0) == walls
    assert found == {"beams": 360, "range_max": 20.0, "returns_median": hits, "walls_median": hits}
    assert hits == (np.abs(np.cos(angles)) > 0.505).sum()
