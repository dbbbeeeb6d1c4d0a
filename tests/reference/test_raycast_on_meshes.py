"""Rays on true meshes: Embree against every triangle by brute force, and against MuJoCo's own mesh rays."""

import importlib.util
import sys
from typing import get_args

import mujoco
import numpy as np
import pytest
import trimesh

from lirs_envs.lidar.lidar import Lidar
from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.lidar.obstacle_rays import GROUND
from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.lidar.ray_casting import MeshCaster, Rays, mujoco_hits
from lirs_envs.robots.robot import make_robot
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.ground import MeshGround
from lirs_wct.world import World
from tests.reference.triangle_rays import triangle_ranges

Array = np.ndarray
needs_embree = pytest.mark.skipif(
    importlib.util.find_spec("embreex") is None, reason="embreex, the extra [mesh], is not installed"
)


def cave(offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> TriangleMesh:
    """A floor with balls and rings that hang and stand: 2,400 triangles, overhangs everywhere."""
    rng = np.random.default_rng(2)
    parts = [trimesh.creation.box((30.0, 30.0, 0.5))]
    for k in range(6):
        ball = trimesh.creation.icosphere(subdivisions=2, radius=rng.uniform(0.5, 2.0))
        ring = trimesh.creation.torus(rng.uniform(1.0, 2.0), 0.3, 8, 8)
        ring.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        for part in (ball, ring)[: 2 - k % 2]:
            part.apply_translation(rng.uniform((-9, -9, 0), (9, 9, 4)))
            parts.append(part)
    whole = trimesh.util.concatenate(parts)
    return TriangleMesh(np.array(whole.vertices) + offset, np.array(whole.faces, dtype=np.int32))


def corners(mesh: TriangleMesh) -> Array:
    return mesh.vertices[mesh.faces]


def unit(d: Array) -> Array:
    return np.ascontiguousarray(d / np.linalg.norm(d, axis=1, keepdims=True))


@needs_embree
@pytest.mark.parametrize(
    "offset", [(0.0, 0.0, 0.0), pytest.param((800.0, -600.0, 90.0), marks=pytest.mark.slow)]
)
def test_equals_brute_force(offset: tuple[float, float, float]) -> None:
    """In the last case a float32 coordinate is a multiple of 6e-5 m."""
    mesh, rng, n = cave(offset), np.random.default_rng(4), 300
    origins = rng.uniform((-12, -12, 0.3), (12, 12, 6), (n, 3)) + offset
    directions = unit(rng.standard_normal((n, 3)))
    # The last third towards nodes and middles of edges: no ray may slip through there.
    triangles = corners(mesh)[rng.integers(0, len(mesh.faces), n // 3)]
    weights = rng.permuted(np.array(((1.0, 0.0, 0.0), (0.5, 0.5, 0.0)))[rng.integers(0, 2, n // 3)], axis=1)
    targets = np.einsum("nk,nkx->nx", weights, triangles)
    directions[-len(targets) :] = unit(targets - origins[-len(targets) :])
    ours = MeshCaster(mesh).ranges(origins, directions, 25.0)
    more, less = (
        triangle_ranges(corners(mesh), origins, directions, grow=grow, max_range=25.0)
        for grow in (1e-5, -1e-5)
    )
    with np.errstate(invalid="ignore"):
        right = [(ours == x) | (np.abs(ours - x) < 1e-6) for x in (more, less)]
    assert (right[0] | right[1]).all()
    assert 0.3 < np.isfinite(ours).mean() < 0.98
    # Only at an edge that nothing lies behind may the two differ: most rays are no matter of rounding.
    assert (more == less)[: n - n // 3].mean() > 0.99


@needs_embree
def test_equals_mujoco_s_mesh_rays() -> None:
    mesh, rng = cave(), np.random.default_rng(5)
    spec = mujoco.MjSpec()
    spec.add_mesh(
        name="cave",
        uservert=mesh.vertices.ravel(),
        userface=mesh.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="cave")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    caster, seen = MeshCaster(mesh), 0
    for origin in rng.uniform((-12, -12, 0.3), (12, 12, 6), (4, 3)):
        directions = unit(rng.standard_normal((300, 3)))
        ours, theirs = (
            caster.ranges(origin, directions, 25.0),
            mujoco_hits(model, data, origin, directions, 25.0)[0],
        )
        # A ray that passes within 1e-5 of an edge may meet what it bounds or what lies behind.
        starts = np.broadcast_to(origin, directions.shape)
        sure = np.equal(
            *(
                triangle_ranges(corners(mesh), starts, directions, grow=grow, max_range=25.0)
                for grow in (1e-5, -1e-5)
            )
        )
        np.testing.assert_allclose(ours[sure], theirs[sure], atol=1e-4)
        _, _, normals = mujoco_hits(model, data, origin, directions, 25.0)
        _, reflectances = caster.hits(origin, directions, 25.0)
        met = sure & np.isfinite(ours)
        expected = GROUND * abs(np.einsum("ij,ij->i", normals, directions))
        np.testing.assert_allclose(reflectances[met], expected[met], atol=1e-4)
        seen += (np.isfinite(ours) & sure).sum()
    assert seen > 400


@needs_embree
def test_a_rolling_scan_casts_each_beam_from_its_own_place() -> None:
    mesh, velocity = cave(), ((2.0, 0.0, 0.0), (0.0, 0.0, 0.5))
    preset = LidarPreset(name="slow", beams=181, fov=3.0, rate=2.0, range_min=0.0, range_max=25.0)
    rng = np.random.default_rng(0)
    lidar = Lidar(preset, MeshCaster(mesh), Pose3(), rng, LidarNoise(), rolling_scan=True)
    pose = Pose3.from_rpy(-11.0, 0.0, 1.2, 0.02, 0.05, 0.1)
    origins, directions = lidar._rays(pose, velocity)
    expected = triangle_ranges(corners(mesh), origins, directions, max_range=25.0)
    scan = lidar.scan(pose, 0.0, velocity=velocity)
    np.testing.assert_allclose(scan.ranges, expected, atol=1e-5)
    assert np.isfinite(expected).mean() > 0.3


GATE = [
    trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))
    for size, at in (
        ((8, 8, 0.5), (0, 0, -0.25)),
        ((1, 2, 2.5), (-2.5, 0, 1.2)),
        ((1, 2, 2.5), (2.5, 0, 1.2)),
        ((6, 2, 0.5), (0, 0, 2.65)),
    )
]


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> World:
    """A slab of 8 x 8 m with a gate on it: the height field from above says that its roof is solid."""
    # It is touched as the boxes that it is made of, which a decomposition would take its time to find.
    monkeypatch.setattr("lirs_wct.contact.spec.convex_parts", lambda *_: iter([box.vertices for box in GATE]))
    whole = trimesh.util.concatenate(GATE)
    solid = TriangleMesh(np.array(whole.vertices), np.array(whole.faces, dtype=np.int32))
    top = np.zeros((81, 81), np.float32)
    top[30:51, 10:71] = 2.9
    return World("gate", MeshGround(HeightField.centered(top, (0.1, 0.1)), solid, overhangs=True))


@needs_embree
def test_a_world_with_overhangs_is_seen_as_mujoco_sees_it(gate: World) -> None:
    scans = []
    for rays in get_args(Rays):
        robot = make_robot("turtlebot2")
        sim = Simulation(
            gate,
            SimulationConfig(
                robot=robot, contact_geometry="convex", noise=SensorNoise(lidar="none"), rays=rays
            ),
        )
        scans.append(sim.reset(Pose2(0.3, -3.0, 1.5)).scan.ranges)
    # The lidar looks along the slab: its beams graze nothing, and the gate's edges are upright.
    jump = np.abs(np.diff(np.nan_to_num(scans[0], posinf=99.0))) > 0.1
    sure = ~(np.append(jump, False) | np.append(False, jump))
    np.testing.assert_allclose(scans[0][sure], scans[1][sure], atol=1e-4)
    assert 50 < np.isfinite(scans[0]).sum() < len(sure) - 50
    middle = len(sure) // 2
    assert np.isposinf(scans[0][middle - 20 : middle + 20]).all(), "through the gate"


@pytest.mark.parametrize("name", ["husky", "jackal", "turtlebot2", "turtlebot3_burger"])
def test_own_body_is_not_seen_among_the_mesh(name: str, gate: World) -> None:
    """MuJoCo's rays straight down through all of the robot, its contact geoms too."""
    sim = Simulation(gate, SimulationConfig(robot=make_robot(name), contact_geometry="convex", rays="mujoco"))
    sim.reset(Pose2(0.0, -2.5))
    T = sim.pose()
    for dx in np.linspace(-0.5, 0.5, 21):
        met = sim.casters[0].ranges(np.array((T.x + dx, T.y, 1.5)), np.array(((0.0, 0.0, -1.0),)), 10.0)
        assert met[0] == pytest.approx(1.5, abs=1e-6)


def test_without_embree_one_clear_error(gate: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(ConfigError, match=r"pip install 'lirs-wct\[mesh\]', or take rays 'mujoco'"):
        MeshCaster(gate.mesh)
