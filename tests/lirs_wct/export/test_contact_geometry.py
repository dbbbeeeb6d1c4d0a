"""What is seen is what is touched: spheres come to rest on the true surface, whatever MuJoCo touches."""

import sys
from typing import get_args

import cv2
import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_validation import validate
from lirs_wct import BuildOptions, World, build_world
from lirs_wct.contact import CONTACT_GEOMETRIES, ContactGeometry
from lirs_wct.contact.parts import convex_parts, prisms
from lirs_wct.contact.spec import RAY_GROUP, TERRAIN_GROUP, ContactGrid, contact_grid, steep_nodes, world_spec
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import ExportOptions, LaserMap, MeshGround, Terrain

RADIUS, SPHERES = 0.3, 40


@pytest.fixture(scope="module")
def hills() -> World:
    """Hills in a bowl, so that nothing rolls off, and a box with upright sides on them."""
    z = cv2.GaussianBlur(np.random.default_rng(8).random((161, 161)).astype(np.float32), (0, 0), 8)
    z = (z - z.min()) / np.ptp(z) * np.float32(1.5)
    z[70:90, 60:100] = z.max() + 0.2
    axis = np.abs(np.linspace(-1, 1, 161, dtype=np.float32))
    z += 3 * np.maximum(axis[:, None], axis) ** 8
    return World(
        "hills", Terrain(HeightField.centered(z, (0.1, 0.1))), export_options=ExportOptions(max_error=0.004)
    )


@pytest.fixture(scope="module")
def arch() -> World:
    """A gate on a slab of 8 x 8 m, 0.5 m thick throughout, as one closed solid with an overhang."""
    cells = np.zeros((16, 16, 8), np.bool_)
    cells[:, :, 0] = True
    cells[2:4, 6:10, :7] = cells[12:14, 6:10, :7] = True
    cells[2:14, 6:10, 6] = True
    solid = blocks(cells, 0.5, np.array((-4.0, -4.0, -0.5)))
    assert solid.is_watertight
    top = np.zeros((81, 81), np.float32)
    top[30:51, 10:71] = 3.0
    return World("arch", MeshGround(HeightField.centered(top, (0.1, 0.1)), solid, overhangs=True))


def blocks(cells: np.ndarray, edge: float, corner: np.ndarray) -> TriangleMesh:
    """The boundary of solid cells (x, y, z), two triangles a square."""
    padded, squares = np.pad(cells, 1), []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (1, 0):
            outside = np.roll(padded, -1 if side else 1, axis)
            at = np.argwhere(padded & ~outside) - 1
            steps = ((0, 0), (1, 0), (1, 1), (0, 1)) if side else ((0, 0), (0, 1), (1, 1), (1, 0))
            square = np.repeat(at[:, None], 4, axis=1)
            square[..., axis] += side
            square[..., u] += [step[0] for step in steps]
            square[..., v] += [step[1] for step in steps]
            squares.append(square)
    corners = np.concatenate(squares)
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    quads = index.reshape(-1, 4)
    faces = np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]])).astype(np.int32)
    return TriangleMesh(vertices * edge + corner, faces)


def dropped(
    world: World, terrain: ContactGeometry, points: np.ndarray, contact: ContactGrid | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 3) centers of spheres after 5 s, when each touches the ground, and whether it does."""
    spec = world_spec(world, contact_geometry=terrain, contact=contact)
    spec.option.timestep = 0.004
    for x, y, z in points:
        ball = spec.worldbody.add_body(
            pos=(x, y, z + RADIUS + 0.05), sleep=mujoco.mjtSleepPolicy.mjSLEEP_NEVER
        )
        ball.add_freejoint()
        # Rolling resistance, so that they rest on slopes too; a stiff contact as the robots have it.
        ball.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(RADIUS, 0, 0),
            contype=2,
            conaffinity=1,
            condim=6,
            friction=(1.0, 0.02, 0.05),
            solref=(0.008, 1),
            priority=1,
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(5 / spec.option.timestep))
    found, touching = data.qpos.reshape(-1, 7)[:, :3].copy(), np.zeros(len(points), np.bool_)
    for _ in range(round(1 / spec.option.timestep)):
        # Those that still roll hop from edge to edge: each is looked at when it touches.
        before = data.qpos.reshape(-1, 7)[:, :3].copy()
        mujoco.mj_step(model, data)
        now = np.unique(model.geom_bodyid[data.contact.geom].max(axis=1)) - 1
        now = now[~touching[now]]
        found[now], touching[now] = before[now], True
    return found, touching


def gaps(mesh: TriangleMesh, centers: np.ndarray) -> np.ndarray:
    """Return (n,) distance between sphere and mesh, meters, negative inside the ground."""
    true = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    _, distance, face = trimesh.proximity.closest_point(true, centers)
    towards = np.einsum("ij,ij->i", centers - true.triangles_center[face], true.face_normals[face])
    return np.where(towards >= 0, distance, -distance) - RADIUS


@pytest.mark.parametrize(
    "terrain", ["hfield", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("mesh", "prisms"))]
)
def test_spheres_rest_on_the_true_surface(terrain: ContactGeometry, hills: World) -> None:
    exact = World("hills", Terrain(hills.surface)).mesh
    rng = np.random.default_rng(1)
    xy = rng.uniform(-7.0, 7.0, (SPHERES, 2))
    z = np.array([hills.surface.height_at(x + np.linspace(-0.3, 0.3, 13)[:, None],
                                          y + np.linspace(-0.3, 0.3, 13)).max() for x, y in xy])  # fmt: skip
    centers, touching = dropped(hills, terrain, np.column_stack((xy, z)))
    inside = hills.surface.contains(centers[:, 0], centers[:, 1])
    assert inside.sum() >= 0.95 * SPHERES
    gap = gaps(exact, centers[inside])
    assert (centers[inside, 2] > hills.surface.height_at(*centers[inside, :2].T)).all()
    assert touching[inside].mean() > 0.8
    assert np.abs(gap[touching[inside]]).max() < 0.01


def gaps_by_sampling(surface: HeightField, centers: np.ndarray) -> np.ndarray:
    """Return (n,) distance between sphere and the surface as the laser sees it, a point each 5 mm."""
    across = np.linspace(-1.05, 1.05, 127) * RADIUS
    found = []
    for x, y, z in centers:
        px, py = x + across[None, :], y + across[:, None]
        pz = surface.height_at(px, py)
        found.append(np.nanmin(np.sqrt((px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2)) - RADIUS)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("terrain", ["hfield", "prisms"])
def test_spheres_on_the_ground_that_users_get(terrain: ContactGeometry) -> None:
    """On the contact grid, and on prisms within 1 cm: what is guaranteed against the true surface.

    Where nothing steep is near, 1 cm. Beside a steep face vertical errors say little, and the face itself may
    stand up to half a contact cell away: half a contact cell.
    """
    world = build_world("medium", BuildOptions(window=(0, 0, 16)))
    surface, grid = world.surface, contact_grid(world.surface)
    assert grid.stride > 1, "the contact grid is the surface itself, so that nothing is tested"
    west, south, east, north = surface.bounds
    rng = np.random.default_rng(1)
    x, y = rng.uniform(west + 1, east - 1, SPHERES), rng.uniform(south + 1, north - 1, SPHERES)
    side = np.linspace(-RADIUS, RADIUS, 25)
    z = surface.height_at(x[:, None, None] + side[:, None], y[:, None, None] + side).max(axis=(1, 2))
    centers, touching = dropped(world, terrain, np.column_stack((x, y, z)), grid)
    kept = touching & surface.contains(centers[:, 0], centers[:, 1])
    assert kept.sum() >= 0.95 * SPHERES
    centers = centers[kept]
    assert (centers[:, 2] > surface.height_at(*centers[:, :2].T)).all()
    gap = np.abs(gaps_by_sampling(surface, centers))
    beside = near_steep(surface, centers)
    assert 0.1 < beside.mean() < 0.8
    assert gap[~beside].max() < 0.01
    assert gap.max() < grid.horizontal_budget


def near_steep(surface: HeightField, centers: np.ndarray) -> np.ndarray:
    """Return (n,) whether a node of a steep triangle is in a sphere's reach."""
    steep = np.argwhere(steep_nodes(surface.south_up, surface.cell, np.radians(45)))[:, ::-1]
    nodes = np.array(surface.origin) + steep * np.array(surface.cell)
    distance, _ = KDTree(nodes).query(centers[:, :2])
    return distance < RADIUS + 2 * max(surface.cell)


@pytest.mark.slow
def test_spheres_rest_on_and_under_an_overhang(arch: World) -> None:
    pytest.importorskip("coacd", reason="coacd, the extra [mesh], is not installed")
    rng = np.random.default_rng(1)
    on_roof = np.column_stack((rng.uniform(-2.5, 2.5, 20), rng.uniform(-0.6, 0.6, 20), np.full(20, 3.0)))
    below = np.column_stack((rng.uniform(-1.5, 1.5, 20), rng.uniform(-3.0, 3.0, 20), np.zeros(20)))
    centers, touching = dropped(arch, "convex", np.concatenate((on_roof, below)))
    assert touching.all()
    assert np.abs(gaps(arch.mesh, centers)).max() < 0.01
    assert (centers[:20, 2] > 3.2).all()
    assert (centers[20:, 2] < 0.4).all()


def test_the_laser_sees_through_the_gate(arch: World) -> None:
    pytest.importorskip("coacd", reason="coacd, the extra [mesh], is not installed")
    simulation = Simulation(arch, SimulationConfig(robot=make_robot("turtlebot2"), contact_geometry="convex"))
    scan = simulation.reset(Pose2(0.0, -3.0, np.pi / 2)).scan
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    ahead, side = np.abs(angles) < 0.1, np.abs(angles - np.arctan2(2.5, 2.0)) < 0.02
    assert np.isposinf(scan.ranges[ahead]).all()
    assert np.isfinite(scan.ranges[side]).all()


def test_a_prism_for_each_triangle_and_no_more_than_are_legal(hills: World) -> None:
    parts = list(prisms(hills))
    up = hills.mesh.face_normals[:, 2] > 1e-9
    assert len(parts) == up.sum()
    edges = np.array([(p[1] - p[0], p[2] - p[0]) for p in parts])
    area = 0.5 * np.abs(np.cross(edges[:, 0], edges[:, 1])[:, 2]).sum()
    assert area == pytest.approx(16.0**2, rel=1e-9)
    full = World("full", Terrain(hills.surface), export_options=ExportOptions(max_error=1e-5))
    with pytest.raises(ConfigError, match=r"at most 20000 are legal; give --max-error or --option"):
        list(prisms(full))


def test_a_terrain_that_does_not_fit_is_refused(
    hills: World, arch: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    walls = World("room", LaserMap(hills.surface, WallGrid(np.eye(4, dtype=np.bool_), 0.1)))
    for world, terrain, says in (
        (hills, "voxels", "legal: convex, hfield, mesh, prisms"),
        (hills, "convex", "closed meshes"),
        (arch, "hfield", "overhangs need"),
        (walls, "prisms", "convex boxes already"),
    ):
        with pytest.raises(ConfigError, match=says):
            world_spec(world, contact_geometry=terrain)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(ConfigError, match=r"pip install 'lirs-wct\[mesh\]'"):
        list(convex_parts(arch.mesh))
    assert get_args(ContactGeometry) == CONTACT_GEOMETRIES


def test_the_seen_mesh_is_whole_and_never_touched(hills: World) -> None:
    model = world_spec(hills, contact_geometry="mesh").compile()
    seen = [g for g in range(model.ngeom) if model.geom(g).name.startswith("seen")]
    assert sum(model.mesh_facenum[model.geom_dataid[g]] for g in seen) == len(hills.mesh.faces)
    assert max(model.mesh_facenum) <= 200_000
    assert all(model.geom_contype[g] == model.geom_conaffinity[g] == 0 for g in seen)
    assert {int(model.geom_group[g]) for g in seen} == {TERRAIN_GROUP}
    assert model.geom("ground").rgba[3] == 0


def test_an_overhang_is_seen_in_its_own_group(arch: World) -> None:
    pytest.importorskip("coacd", reason="coacd, the extra [mesh], is not installed")
    model = world_spec(arch, contact_geometry="convex").compile()
    groups = {model.geom(g).name.rstrip("0123456789"): int(model.geom_group[g]) for g in range(model.ngeom)}
    assert groups == {"ground": TERRAIN_GROUP, "seen": RAY_GROUP}


def test_a_robot_falls_into_no_hole_and_drives_on_the_floor_beside() -> None:
    kind = np.zeros((60, 60), np.bool_)
    hole = kind.copy()
    hole[20:40, 20:40] = True
    floor = HeightField(np.zeros((2, 2), np.float32), (6.0, 6.0), (0.0, 0.0))
    world = World("pit", LaserMap(floor, WallGrid(kind, 0.1, hole=hole)))
    spec = world_spec(world)
    for x, y in ((3.0, 3.0), (1.0, 1.0)):
        ball = spec.worldbody.add_body(pos=(x, y, 0.2))
        ball.add_freejoint()
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    assert data.qpos[2] < -5
    assert data.qpos[9] == pytest.approx(0.1, abs=0.002)
    free = world.traversable(clearance=0.3, max_slope=0.3)
    row, col = free.cells((3.0, 3.0))
    assert not free.free[row, col]
    row, col = free.cells((1.0, 1.0))
    assert free.free[row, col]


@pytest.mark.parametrize("terrain", ["mesh", pytest.param("prisms", marks=pytest.mark.slow)])
def test_a_run_says_what_was_touched(terrain: ContactGeometry) -> None:
    options = BuildOptions(max_triangles=3000, window=(0, 0, 20))
    run = validate("simple", seconds=1, terrain=terrain, options=options)
    assert run.record.status == "ok"
    assert run.record.config.terrain == terrain
    contact = run.record.world["contact"]
    assert contact["terrain"] == terrain
    assert contact["parts"] > 1000 if terrain == "prisms" else contact["vertical"] <= 0.01
