"""A world in MuJoCo is the same world: heights, walls, the right way up and round."""

import math
from pathlib import Path
from xml.etree import ElementTree

import cv2
import mujoco
import numpy as np
import pytest

from lirs_wct import BuildOptions, build_world
from lirs_wct.contact.spec import contact_grid, world_spec
from lirs_wct.export.appearance import cube_uv
from lirs_wct.export.mjcf import spread, write_mjcf
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import LaserMap, Terrain
from lirs_wct.world import World


@pytest.fixture
def slanted() -> World:
    """Higher in the north-east, lowest in the south-west, and nowhere 0: nothing in it is symmetrical."""
    rng = np.random.default_rng(3)
    z = rng.random((7, 11)) + 0.5 * np.arange(11)[None, :] + 2.0 * np.arange(7)[::-1, None] - 4.3
    return World("slanted", Terrain(HeightField(z.astype(np.float32), (0.5, 0.25), (100.0, -30.0))))


@pytest.fixture
def walled() -> World:
    solid = np.zeros((12, 20), np.bool_)
    solid[0, :] = solid[3:9, 5:7] = solid[11, 3] = True
    walls = WallGrid(solid, 0.1, Pose2(-1.5, 2.25, 0.7), 1.7)
    floor = HeightField(np.zeros((2, 2), np.float32), (8.0, 8.0), (-4.0, -1.0))
    return World("walled", LaserMap(floor, walls))


def height_under(model: mujoco.MjModel, x: float, y: float) -> float:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hit = np.zeros(1, np.int32)
    top = np.array((x, y, 50.0))
    distance = mujoco.mj_ray(model, data, top, np.array((0.0, 0.0, -1.0)), None, 1, -1, hit)
    return math.nan if distance < 0 else 50.0 - distance


def heights(model: mujoco.MjModel) -> np.ndarray:
    low, relief = model.geom("ground").pos[2], model.hfield_size[0, 2]
    return low + relief * model.hfield_data.reshape(model.hfield_nrow[0], model.hfield_ncol[0])


def test_the_written_file_is_exact_to_the_bit(slanted: World, tmp_path: Path) -> None:
    path = write_mjcf(slanted, tmp_path)
    assert path == tmp_path / "slanted.xml"
    (binary,) = tmp_path.glob("*.hfield")
    raw = binary.read_bytes()
    assert tuple(np.frombuffer(raw, "<i4", 2)) == slanted.surface.shape
    stored = np.frombuffer(raw, "<f4", offset=8).reshape(slanted.surface.shape)
    assert stored.tobytes() == slanted.surface.z[::-1].tobytes()
    model = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(heights(model), slanted.surface.z[::-1], atol=2e-6)


def test_upright_and_in_place(slanted: World, tmp_path: Path) -> None:
    written = mujoco.MjModel.from_xml_path(str(write_mjcf(slanted, tmp_path)))
    passed = world_spec(slanted).compile()
    west, south, east, north = slanted.surface.bounds
    rng = np.random.default_rng(0)
    for x, y in zip(rng.uniform(west, east, 20), rng.uniform(south, north, 20), strict=True):
        true = float(slanted.surface.height_at(x, y))
        assert height_under(written, x, y) == pytest.approx(true, abs=1e-5)
        assert height_under(passed, x, y) == pytest.approx(true, abs=1e-5)
    assert height_under(passed, east - 0.1, north - 0.1) > height_under(passed, west + 0.1, south + 0.1) + 5


def test_same_name_other_world_is_not_taken_from_the_cache(slanted: World, tmp_path: Path) -> None:
    flipped = World("slanted", Terrain(HeightField(slanted.surface.z[::-1].copy(), (0.5, 0.25), (0.0, 0.0))))
    for world in (slanted, flipped):
        model = mujoco.MjModel.from_xml_path(str(write_mjcf(world, tmp_path)))
        np.testing.assert_allclose(heights(model), world.surface.z[::-1], atol=2e-6)


def test_a_flat_field_keeps_its_height(tmp_path: Path) -> None:
    flat = World("flat", Terrain(HeightField(np.full((5, 5), 3.25, np.float32), (1.0, 1.0), (0.0, 0.0))))
    for model in (
        world_spec(flat).compile(),
        world_spec(flat, contact=contact_grid(flat.surface)).compile(),
        mujoco.MjModel.from_xml_path(str(write_mjcf(flat, tmp_path))),
    ):
        assert height_under(model, 1.3, 2.1) == pytest.approx(3.25)


def test_a_contact_grid_is_what_is_touched(slanted: World) -> None:
    axis = np.linspace(0, 3, 61)
    surface = HeightField.centered(np.sin(axis)[None, :].repeat(61, axis=0).astype(np.float32), (0.05, 0.05))
    smooth = World("smooth", Terrain(surface))
    grid = contact_grid(surface)
    model = world_spec(smooth, contact=grid).compile()
    assert grid.stride > 1
    assert model.hfield_ncol[0] == math.ceil(60 / grid.stride) + 1
    for x in np.linspace(-1.4, 1.4, 15):
        assert height_under(model, x, 0.2) == pytest.approx(float(surface.height_at(x, 0.2)), abs=0.0101)


@pytest.mark.parametrize("source", ["spec", "file"])
def test_walls_stand_where_the_map_has_them(source: str, walled: World, tmp_path: Path) -> None:
    if source == "spec":
        model = world_spec(walled).compile()
    else:
        model = mujoco.MjModel.from_xml_path(str(write_mjcf(walled, tmp_path)))
    walls = walled.walls
    assert walls is not None
    rows, cols = np.mgrid[: walls.shape[0], : walls.shape[1]]
    centers = walls.origin.apply(np.stack((cols + 0.5, rows + 0.5), axis=-1) * walls.resolution)
    for solid, (x, y) in zip(walls.solid.ravel(), centers.reshape(-1, 2), strict=True):
        assert height_under(model, x, y) == pytest.approx(1.7 if solid else 0.0, abs=1e-6)
    boxes = model.geom_size[model.geom_type == mujoco.mjtGeom.mjGEOM_BOX]
    assert 4 * boxes[:, 0] @ boxes[:, 1] == pytest.approx(walls.solid.sum() * 0.01)


def test_sleeping_leaves_the_motion_as_it_is(walled: World) -> None:
    ends = []
    for sleep in (True, False):
        spec = world_spec(walled)
        if not sleep:
            spec.option.enableflags = 0
        ball = spec.worldbody.add_body(pos=(0.3, 2.9, 1.0), sleep=mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
        ball.add_freejoint()
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0))
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qvel[:2] = (-1.5, 0.4)
        mujoco.mj_step(model, data, 600)
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(ends[0], ends[1])


ROOT = Path(__file__).parents[3]
LATER = {"colorspace", "sleep", "inertia"}


@pytest.mark.parametrize("source", ["simple", str(ROOT / "examples/data/office.yaml")])
def test_no_attribute_of_a_later_version_is_written(source: str, tmp_path: Path) -> None:
    path = write_mjcf(build_world(source), tmp_path)
    root = ElementTree.parse(path).getroot()
    assert not LATER & {name for element in root.iter() for name in element.attrib}
    assert all("type" not in light.attrib for light in root.iter("light"))
    assert root.find("option") is None
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.light_type[0] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL


def test_a_mesh_in_several_tiles_has_their_shells_as_inertia(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lirs_wct.export.mjcf.MUJOCO_FACES", 60)
    path = write_mjcf(build_world(ROOT / "examples/data/office.yaml"), tmp_path)
    meshes = list(ElementTree.parse(path).getroot().iter("mesh"))
    assert len(meshes) > 3
    assert {mesh.get("inertia") for mesh in meshes if "walls" in mesh.attrib["name"]} == {"shell"}
    assert mujoco.MjModel.from_xml_path(str(path)).nmesh == len(meshes)


def test_starts_are_sites_on_the_ground_to_which_a_robot_is_attached(tmp_path: Path) -> None:
    start = Pose2(3.0, -4.0, 0.5)
    world = build_world("medium", BuildOptions(start=start))
    model = mujoco.MjModel.from_xml_path(str(write_mjcf(world, tmp_path)))
    assert model.nsite == len(world.spawn_poses) == 8
    site = model.site("start")
    np.testing.assert_allclose(site.pos, (3.0, -4.0, world.surface.height_at(3.0, -4.0)), atol=1e-9)
    np.testing.assert_allclose(site.quat, (np.cos(0.25), 0, 0, np.sin(0.25)), atol=1e-9)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "dunes.png"
    cv2.imwrite(str(path), np.random.default_rng(1).integers(0, 9, (11, 21)).astype(np.uint8))
    return path


@pytest.fixture
def checks(tmp_path: Path) -> np.ndarray:
    colors = np.random.default_rng(2).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    picture = colors.repeat(16, axis=0).repeat(16, axis=1)
    cv2.imwrite(str(tmp_path / "checks.jpg"), picture)
    cv2.imwrite(str(tmp_path / "checks.png"), picture)
    return picture


@pytest.mark.parametrize("texture_size", [None, 3.0])
def test_a_point_has_the_color_that_cube_projection_gives_it(
    picture: Path, checks: np.ndarray, texture_size: float | None
) -> None:
    world = build_world(picture, BuildOptions(size=10, height=0.01))
    laid = spread(checks, world.surface.size, texture_size or 10.0)
    dressed = cube_uv(world.mesh, texture_size)
    assert dressed.normals is not None
    assert dressed.uv is not None
    west, south, _, _ = world.surface.bounds
    seen = 0
    for face in dressed.faces[(dressed.normals[dressed.faces][..., 2] > 0.9).all(axis=1)]:
        u, v = dressed.uv[face].mean(axis=0) % 1
        x, y = dressed.vertices[face, :2].mean(axis=0) - (west, south)
        # Not at the edge of a check, where half a pixel decides.
        if min(u * 8 % 1, v * 8 % 1, 1 - u * 8 % 1, 1 - v * 8 % 1) < 0.1:
            continue
        on_mesh = checks[int((1 - v) * 128), int(u * 128)]
        rows, cols = laid.shape[:2]
        on_ground = laid[int((1 - y / world.surface.size[1]) * rows), int(x / world.surface.size[0] * cols)]
        np.testing.assert_array_equal(on_ground, on_mesh)
        seen += 1
    assert seen > 50
