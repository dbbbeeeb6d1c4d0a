"""A mesh file becomes a world: its heights from above, its own triangles in the files."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lirs_wct import BuildOptions, World, build_world
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.export.mesh_writer import write_mesh
from lirs_wct.formats.meshes.mesh_reader import read_upright
from lirs_wct.formats.suffixes import MESHES
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.sources.rasterize import layers, rasterize_heights


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
    with pytest.raises(ConfigError, match="--pixel-size"):
        build_world(path, BuildOptions(pixel_size=1))
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
    with pytest.raises(SourceError, match=r"two\.stl: has overhangs and is not closed"):
        build_world(tmp_path / "two.stl")


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


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_likely_millimeters_are_told(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"steps{suffix}"
    trimesh.creation.box((2000, 800, 150)).export(path)
    with pytest.warns(UserWarning, match=r"steps\..*: is 2000 x 800 x 150 m, .* give --scale 0\.001") as told:
        build_world(path)
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert build_world(path, BuildOptions(scale=(1e-3,) * 3)).surface.size == pytest.approx((2, 0.8))


@pytest.mark.parametrize("name", ["large.dae", "large.glb", "ours.stl", "ours.obj", "small.stl"])
def test_files_that_are_in_meters_are_not(name: str, tmp_path: Path) -> None:
    side = 900 if name == "small.stl" else 3000
    box = trimesh.creation.box((side, side, 100))
    write_mesh(tmp_path / name, TriangleMesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32)))
    if name == "small.stl":
        box.export(tmp_path / name)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert build_world(tmp_path / name).surface.size == pytest.approx((side, side))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "told"),
    [("unitree_mujoco__terrain.STL", True), ("map2gazebo__map.stl", False), ("mujoco__pyramid.stl", False)],
)
def test_real_millimeters(name: str, told: bool, shared_data: Path) -> None:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        build_world(shared_data / "stl" / name)
    assert any("--scale 0.001" in str(w.message) for w in found) == told


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
