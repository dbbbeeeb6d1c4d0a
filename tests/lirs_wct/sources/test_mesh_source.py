"""A mesh file becomes a world: its heights from above, its own triangles in the files."""

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from lirs_envs.lidar.ray_casting import MeshCaster
from lirs_wct import BuildOptions, World, build_world
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.export.mesh_writer import write_mesh
from lirs_wct.export.package import write_package
from lirs_wct.formats import MESHES
from lirs_wct.formats.meshes.reader import read_upright
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import TriangleMesh, layers, rasterize_heights
from lirs_wct.meshing.solid import solid_mesh
from tests.kit import built


@pytest.fixture
def hill() -> TriangleMesh:
    x = np.linspace(0, 3, 31)
    z = (np.sin(x)[None, :] + np.cos(2 * x)[:21, None] + 2).astype(np.float32)
    return solid_mesh(HeightField(z, (0.5, 0.4), (10.0, -5.0)))


def test_draping_gives_the_nodes_back(hill: TriangleMesh) -> None:
    top = rasterize_heights(hill, (10.0, -5.0, 0.5, 0.4), (21, 31))
    np.testing.assert_allclose(
        top.ravel(), hill.vertices[: 21 * 31, 2].reshape(21, 31)[::-1].ravel(), atol=1e-6
    )
    assert (layers(hill, (10.0, -5.0, 0.5, 0.4), (21, 31)) == 2).all()
    outside = rasterize_heights(hill, (9.0, -5.0, 0.5, 0.4), (21, 31))
    assert np.isnan(outside[:, :2]).all()
    assert np.isfinite(outside[:, 2:]).all()


@pytest.mark.parametrize("suffix", MESHES)
def test_a_closed_terrain_of_any_format(suffix: str, hill: TriangleMesh, tmp_path: Path) -> None:
    write_mesh(tmp_path / f"hill{suffix}", hill)
    world = build_world(tmp_path / f"hill{suffix}", BuildOptions(resolution=0.1))
    assert (world.name, world.kind, world.overhangs, world.no_ground) == ("hill", "mesh", False, None)
    assert world.surface.bounds == pytest.approx((10, -5, 25, 3), abs=1e-4)
    assert world.surface.shape == (81, 151)
    assert world.mesh.is_watertight
    assert len(world.mesh.faces) == len(hill.faces)
    rng = np.random.default_rng(0)
    for x, y in zip(rng.uniform(10, 25, 50), rng.uniform(-5, 3, 50), strict=True):
        true = rasterize_heights(hill, (x, y, 1.0, 1.0), (1, 1))[0, 0]
        assert world.surface.height_at(x, y) == pytest.approx(true, abs=0.01)


def test_meters_and_windows(hill: TriangleMesh, tmp_path: Path) -> None:
    path = tmp_path / "hill.stl"
    write_mesh(path, hill)
    assert build_world(path, BuildOptions(size=30)).surface.size == pytest.approx((30, 16))
    high = build_world(path, BuildOptions(height=7, z_scale=2))
    assert np.ptp(high.mesh.bounds[:, 2]) == pytest.approx(14)
    assert build_world(path, BuildOptions(scale=(2, 1, 1))).surface.bounds[0] == pytest.approx(20)
    part = build_world(path, BuildOptions(window=(15, -1, 4), resolution=0.05))
    assert part.kind == "terrain"
    assert part.surface.bounds == pytest.approx((13, -3, 17, 1))
    assert part.surface.z.min() == 0
    with pytest.raises(ConfigError, match="outside the mesh"):
        build_world(path, BuildOptions(window=(150, -1, 4)))
    with pytest.raises(ConfigError, match="--resolution"):
        build_world(path, BuildOptions(resolution=1e-4))


def test_inside_out_is_turned_and_overhangs_are_noticed(hill: TriangleMesh, tmp_path: Path) -> None:
    write_mesh(tmp_path / "out.stl", TriangleMesh(hill.vertices, np.ascontiguousarray(hill.faces[:, ::-1])))
    assert build_world(tmp_path / "out.stl").mesh.volume == pytest.approx(hill.volume, rel=1e-5)
    trimesh.creation.torus(3, 1).apply_transform(
        trimesh.transformations.rotation_matrix(math.pi / 2, (1, 0, 0))
    ).export(tmp_path / "ring.stl")
    ring = build_world(tmp_path / "ring.stl", BuildOptions(resolution=0.1))
    assert ring.overhangs
    with pytest.raises(ConfigError, match="has overhangs"):
        build_world(tmp_path / "ring.stl", BuildOptions(window=(0, 0, 1)))
    loaded = World.load(ring.save(tmp_path / "saved"))
    assert loaded.overhangs
    assert np.array_equal(loaded.mesh.faces, ring.mesh.faces)
    assert np.array_equal(loaded.no_ground, ring.no_ground)  # type: ignore[arg-type]


def test_an_open_sheet_is_taken_by_its_heights(hill: TriangleMesh, tmp_path: Path) -> None:
    sheet = TriangleMesh(hill.vertices, np.ascontiguousarray(hill.faces[: 2 * 20 * 30]))
    write_mesh(tmp_path / "sheet.ply", sheet)
    with pytest.warns(UserWarning, match=r"sheet\.ply: is not closed"):
        world = build_world(tmp_path / "sheet.ply")
    assert world.kind == "terrain"
    assert world.mesh.is_watertight
    two = np.concatenate((sheet.vertices, sheet.vertices + np.array((0, 0, 5))))
    faces = np.concatenate((sheet.faces, sheet.faces + len(sheet.vertices)))
    write_mesh(tmp_path / "two.stl", TriangleMesh(two, faces))
    with pytest.warns(UserWarning, match=r"two\.stl: is not closed, contact is one-sided"):
        world = build_world(tmp_path / "two.stl")
    assert (world.kind, world.overhangs) == ("mesh", True)


def prisms(path: Path, *outlines: list[tuple[float, float]]) -> Path:
    """Write closed bodies of 0.2 m depth from their outlines in x and z, anticlockwise."""
    rows: list[str] = []
    count = 0
    for outline in outlines:
        n = len(outline)
        rows += [f"v {x} {y} {z}" for y in (0, 0.2) for x, z in outline]
        front = range(count + 1, count + n + 1)
        rows += [f"f {' '.join(map(str, front))}", f"f {' '.join(str(i + n) for i in reversed(front))}"]
        rows += [
            f"f {count + (i + 1) % n + 1} {count + i + 1} {count + i + 1 + n} {count + (i + 1) % n + 1 + n}"
            for i in range(n)
        ]
        count += 2 * n
    path.write_text("\n".join(rows))
    return path


DOOR = [(0, 0), (1.5, 0), (1.5, 2), (2.5, 2), (2.5, 0), (4, 0), (4, 3), (0, 3)]
LOW_DOOR = [(0, 0), (4.4, 0), (4.4, 2), (5.6, 2), (5.6, 0), (10, 0), (10, 10), (0, 10)]
BLOCK = [(0, 0), (2, 0), (2, 0.6), (0, 0.6)]
SHEET = [(0, 0), (4.9, 0), (5, 2.8), (10, 2.8), (10, 3), (5, 3), (4.9, 0.2), (0, 0.2)]


@pytest.mark.parametrize(
    ("outlines", "overhangs"),
    [
        pytest.param([LOW_DOOR], True, id="low door in a high wall"),
        pytest.param([BLOCK, [(x + 4, z + 2) for x, z in BLOCK]], True, id="block in the air"),
        pytest.param([BLOCK, [(x + 4, z) for x, z in BLOCK]], False, id="blocks on the ground"),
        pytest.param([SHEET], False, id="sheet with a steep ramp"),
    ],
)
def test_openings_of_a_closed_mesh_are_noticed(
    outlines: list[list[tuple[float, float]]], overhangs: bool, tmp_path: Path
) -> None:
    assert built(prisms(tmp_path / "mesh.obj", *outlines))[0].overhangs == overhangs


def test_an_open_house_is_built_for_every_consumer(tmp_path: Path) -> None:
    """A floor and four walls without thickness, one with a door, below a roof."""
    path = open_house(tmp_path / "house.obj")
    with pytest.warns(UserWarning, match="is not closed, contact is one-sided"):
        world = build_world(path)
    out = write_package(world, tmp_path, formats=("sdf", "glb", "mjcf", "stl"))
    for mesh in ("meshes/house.glb", "meshes/house.stl"):
        assert trimesh.load_mesh(out / mesh).area == pytest.approx(120 + 24 + 2 * 10 + 15 + 12.5)
    assert (out / "model.sdf").exists()
    model = mujoco.MjModel.from_xml_path(str(out / "house.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = np.zeros(1, np.int32)
    for x, expected in ((0.0, 5.0), (2.0, 4.0)):  # through the door to the border, and onto the wall
        start = np.array((x, 6.0, 1.0))
        found = mujoco.mj_ray(model, data, start, np.array((0.0, -1.0, 0.0)), None, 1, -1, geom)
        assert found == pytest.approx(8.0 if x == 0 else expected, abs=0.11), x


def open_house(path: Path, roof: bool = True) -> Path:
    def sheet(*corners: tuple[float, float, float]) -> trimesh.Trimesh:
        return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])

    def wall(x0: float, y0: float, x1: float, y1: float) -> trimesh.Trimesh:
        return sheet((x0, y0, 0), (x1, y1, 0), (x1, y1, 2.5), (x0, y0, 2.5))

    walls = [
        wall(-3, -2, 3, -2),
        wall(3, -2, 3, 2),
        wall(-3, 2, -3, -2),
        wall(3, 2, 0.5, 2),
        wall(-0.5, 2, -3, 2),
    ]
    if roof:
        walls.append(sheet((-3, -2, 2.5), (3, -2, 2.5), (3, 2, 2.5), (-3, 2, 2.5)))
    floor = sheet((-6, -5, 0), (6, -5, 0), (6, 5, 0), (-6, 5, 0))
    trimesh.util.concatenate([floor, *walls]).export(path)
    return path


@pytest.mark.parametrize("closed", [True, False])
def test_a_mesh_far_from_its_origin_is_that_at_the_origin(
    closed: bool, hill: TriangleMesh, tmp_path: Path
) -> None:
    faces = hill.faces if closed else hill.faces[: 2 * 20 * 30]
    worlds = []
    for name, shift in (("near", (0.0, 0.0, 0.0)), ("far", (500_000.0, 5_300_000.0, 400.0))):
        trimesh.Trimesh(hill.vertices + shift, faces, process=False).export(
            tmp_path / f"{name}.obj", digits=6
        )
        world, told = built(tmp_path / f"{name}.obj")
        worlds.append(world)
        assert sum("lies far from its origin: its point 500" in line for line in told) == (name == "far")
    near, far = worlds
    assert far.mesh.is_watertight_as_written
    np.testing.assert_allclose(np.ptp(far.mesh.bounds, axis=0), np.ptp(near.mesh.bounds, axis=0), atol=1e-4)
    np.testing.assert_allclose(
        far.surface.z - far.surface.z.min(), near.surface.z - near.surface.z.min(), atol=1e-4
    )
    assert near.place is None
    corner = np.add(near.surface.bounds[:2], (500_000, 5_300_000))
    assert far.place.coordinates(*far.surface.bounds[:2]) == pytest.approx(corner, abs=1e-3)
    assert far.place.height == pytest.approx(
        400 + float(near.mesh.bounds[0, 2] if closed else near.surface.z.min()), abs=1e-3
    )


def test_a_scaled_far_mesh_keeps_its_place(hill: TriangleMesh, tmp_path: Path) -> None:
    shifted = hill.vertices / 0.3048 + (2e6, 7e5, 300.0)
    trimesh.Trimesh(shifted, hill.faces, process=False).export(tmp_path / "feet.obj", digits=6)
    with pytest.warns(UserWarning, match="lies far from its origin"):
        world = build_world(tmp_path / "feet.obj", BuildOptions(scale=(0.3048,) * 3))
    assert np.ptp(world.mesh.bounds, axis=0) == pytest.approx(np.ptp(hill.bounds, axis=0), abs=1e-4)
    corner = world.place.coordinates(*world.mesh.bounds[0, :2])
    assert corner == pytest.approx(shifted.min(axis=0)[:2], abs=1e-3)
    assert world.place.height == pytest.approx(0.3048 * 300.0 + hill.bounds[0, 2], abs=1e-3)
    with pytest.warns(UserWarning, match="lies far from its origin"):
        part = build_world(tmp_path / "feet.obj", BuildOptions(scale=(0.3048,) * 3, window=(0.0, 0.0, 3.0)))
    x, y = part.surface.bounds[:2]
    assert part.surface.height_at(x, y) + part.place.height == pytest.approx(
        world.surface.height_at(x, y) + world.place.height, abs=1e-3
    )


@pytest.mark.parametrize(
    ("suffix", "authored", "given"), [("obj", "y", "y"), ("glb", "z", "z"), ("dae", "y", "y")]
)
def test_the_axis_that_points_up_can_be_given(
    suffix: str, authored: str, given: Any, hill: TriangleMesh, tmp_path: Path
) -> None:
    mesh = TriangleMesh(hill.vertices, hill.faces[: 2 * 20 * 30])
    path = tmp_path / f"sheet.{suffix}"
    turned = mesh.rotated_x(-90.0) if authored == "y" else mesh
    trimesh.Trimesh(turned.vertices, turned.faces, process=False).export(path)
    if suffix == "dae":
        path.write_text(path.read_text().replace("Y_UP", "Z_UP"))
    with pytest.warns(UserWarning, match=f"{given.upper()} up\\? --up {given}"):
        build_world(path)
    world, told = built(path, up=given)
    assert not any("up?" in line for line in told)
    assert world.kind == "terrain"
    np.testing.assert_allclose(
        np.ptp(world.mesh.bounds[:, :2], axis=0), np.ptp(mesh.bounds[:, :2], axis=0), rtol=1e-5
    )


def test_upright_meshes_raise_no_question(hill: TriangleMesh, tmp_path: Path) -> None:
    trimesh.creation.box((4, 0.2, 3)).export(tmp_path / "wall.stl")
    trimesh.creation.box((40, 1, 30)).export(tmp_path / "slab.stl")
    trimesh.Trimesh(hill.vertices, hill.faces).export(tmp_path / "hill.obj")
    for name in ("wall.stl", "slab.stl", "hill.obj"):
        assert not any("up?" in line for line in built(tmp_path / name)[1]), name
    flat = trimesh.Trimesh([[0, 1, 0], [3, 1, 0], [3, 1, 2]], [[0, 1, 2]])
    flat.export(tmp_path / "flat.obj")
    with pytest.raises(SourceError, match=r"an extent along x and y, this is 3 x 0 x 2 m; is y up\? --up y"):
        build_world(tmp_path / "flat.obj")


def test_millimeters_are_suspected_in_any_file(tmp_path: Path) -> None:
    for suffix, size, told in (
        ("glb", (12_000, 3000, 8000), True),
        ("obj", (12_000, 8000, 30), True),
        ("glb", (90_000, 2500, 80_000), False),
        ("stl", (900, 900, 120), False),
        ("glb", (600, 400, 250), False),
        ("obj", (600, 400, 250), True),
    ):
        path = tmp_path / f"house.{suffix}"
        trimesh.creation.box(size).export(path)
        lines = built(path, resolution=size[0] / 64)[1]
        assert any("if it is the millimeter" in line for line in lines) == told, size
    assert not any("the millimeter" in line for line in built(path, scale=(0.001, 0.001, 0.001))[1])


def test_nodes_far_apart_are_told(tmp_path: Path) -> None:
    for side, options, told in ((300, {}, True), (200, {}, False), (300, {"resolution": 3.0}, False)):
        trimesh.creation.box((side, side / 4, 20)).export(tmp_path / "site.stl")
        lines = built(tmp_path / "site.stl", **options)[1]
        assert any("found at nodes 0.29 m apart; --option resolution=" in line for line in lines) == told


@pytest.mark.parametrize(
    ("head", "side", "told"),
    [
        ("units: millimeters", 8, "it names"),
        ("UNITS=mm", 8000, "it names"),
        ("in meters", 8000, ""),
        ("by program 5", 8000, "if it is"),
        ("by program 5", 8, ""),
    ],
)
def test_a_unit_in_the_first_line_counts(head: str, side: float, told: str, tmp_path: Path) -> None:
    box = trimesh.creation.box((side, side, side / 20))
    (tmp_path / "box.obj").write_text(f"# {head}\n{box.export(file_type='obj')}")
    lines = [line for line in built(tmp_path / "box.obj")[1] if "--option scale=0.001" in line]
    assert ["; " + told in line for line in lines] == [True] * bool(told)


def test_where_there_is_no_ground_nothing_drives(tmp_path: Path) -> None:
    trimesh.creation.cylinder(10, 2).export(tmp_path / "disc.stl")
    with pytest.warns(UserWarning, match="nodes have no ground"):
        world = build_world(tmp_path / "disc.stl", BuildOptions(resolution=0.1))
    assert world.no_ground is not None
    free = world.traversable(clearance=0.3, max_slope=0.3)
    assert free.free.sum() * 0.01 == pytest.approx(math.pi * 9.7**2, rel=0.02)
    assert all(math.hypot(s.x, s.y) < 10 for s in world.spawn_poses)


def test_what_is_no_terrain_is_refused(tmp_path: Path) -> None:
    wall = TriangleMesh(np.array([(0.0, 0, 0), (1, 0, 0), (0, 0, 1)]), np.array([(0, 1, 2)], np.int32))
    write_mesh(tmp_path / "wall.stl", wall)
    with pytest.raises(SourceError, match=r"wall\.stl: a terrain needs an extent along x and y"):
        build_world(tmp_path / "wall.stl")
    (tmp_path / "none.obj").write_text("# nothing\n")
    with pytest.raises(SourceError, match=r"none\.obj: "):
        build_world(tmp_path / "none.obj")


@pytest.mark.parametrize("name", ["large.dae", "large.glb", "ours.stl", "ours.obj", "small.stl"])
def test_files_that_are_in_meters_are_not(name: str, tmp_path: Path) -> None:
    side = 900 if name == "small.stl" else 3000
    box = trimesh.creation.box((side, side, 100))
    write_mesh(tmp_path / name, TriangleMesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32)))
    if name == "small.stl":
        box.export(tmp_path / name)
    world, told = built(tmp_path / name, resolution=side / 512)
    assert (world.surface.size, told) == (pytest.approx((side, side)), [])


@pytest.mark.shared
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_real_meshes(shared_data: Path) -> None:
    kinds = {}
    for path in sorted(shared_data.glob("stl/*")):
        world = build_world(path, BuildOptions(resolution=np.ptp(read_upright(path).bounds[:, 0]) / 300))
        assert world.mesh.is_watertight
        kinds[world.name] = world.kind
    assert kinds == {
        "map2gazebo__map": "terrain",
        "mujoco__pyramid": "mesh",
        "unitree_mujoco__terrain": "mesh",
    }


def test_rays_pass_a_door_in_every_file(tmp_path: Path) -> None:
    """A wall of two concave polygons, as modeling programs write it."""
    world = build_world(prisms(tmp_path / "door.obj", DOOR))
    assert world.mesh.is_watertight
    out = write_package(world, tmp_path / "out", formats=("stl", "dae", "glb", "mjcf"))
    starts = np.array([(x, -1.0, z) for x in (0.7, 2.0, 3.2) for z in (0.5, 1.5, 2.5)])
    blocked = np.array([not (1.5 < x < 2.5 and z < 2) for x, _, z in starts])
    for name in ("meshes/door.stl", "meshes/door.dae", "meshes/door.glb"):
        mesh = trimesh.load_mesh(out / name)
        if name.endswith("glb"):
            mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
        hits = mesh.ray.intersects_any(starts, np.tile((0.0, 1.0, 0.0), (9, 1)))
        np.testing.assert_array_equal(hits, blocked, err_msg=name)
    model = mujoco.MjModel.from_xml_path(str(out / "door.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hit = [
        mujoco.mj_ray(model, data, start, np.array((0.0, 1.0, 0.0)), None, 1, -1, np.zeros(1, np.int32))
        for start in starts
    ]
    np.testing.assert_array_equal(np.array(hit) >= 0, blocked)
    assert world.overhangs
    pytest.importorskip("embreex")
    seen = MeshCaster(world.mesh).ranges(starts, np.tile((0.0, 1.0, 0.0), (9, 1)), 30.0)
    np.testing.assert_array_equal(np.isfinite(seen), blocked)
