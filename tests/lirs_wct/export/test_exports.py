"""What other programs get of a world: GLB, USD, gz-sim's file, and a map for planners."""

import math
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from lirs_wct import BuildOptions, World, build_world
from lirs_wct.errors import ConfigError
from lirs_wct.export.package import ground_truth_map, write_package
from lirs_wct.formats.map_server import read_map
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import Terrain

ROOT = Path(__file__).parents[3]
OFFICE = ROOT / "examples/data/office.yaml"


@pytest.fixture(scope="module")
def gate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pillars, 1 x 1 x 3 m, at x = -2 and 2, and a beam of 6 m from 3.05 m up, on a plate of 20 m."""
    boxes = [trimesh.creation.box((1, 1, 3)).apply_translation((x, 0, 1.5)) for x in (-2, 2)]
    boxes.append(trimesh.creation.box((6, 1, 0.5)).apply_translation((0, 0, 3.3)))
    boxes.append(trimesh.creation.box((20, 20, 0.5)).apply_translation((0, 0, -0.25)))
    path = tmp_path_factory.mktemp("gate") / "gate.stl"
    trimesh.util.concatenate(boxes).export(path)
    return path


@pytest.mark.slow
def test_a_picture_is_built_without_the_imports_of_meshes_and_clouds(tmp_path: Path) -> None:
    code = (
        "import sys; from lirs_wct import build_world; from lirs_wct.export.package import write_package;"
        f"write_package(build_world({str(ROOT / 'examples/data/dunes.png')!r}), {str(tmp_path)!r});"
        "print({'trimesh', 'scipy.ndimage', 'scipy.sparse', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
    assert list(tmp_path.glob("dunes/**/*.dae"))


def occupied(grid: Any, x: float, y: float) -> bool:
    row, col = grid.cells((x, y))
    return bool(grid.occupied[row, col])


def test_a_map_of_a_gate_lets_robots_through_that_are_lower(gate: Path) -> None:
    world = build_world(gate)
    low, high = ground_truth_map(world, 0.3), ground_truth_map(world, 3.2)
    for grid in (low, high):
        assert occupied(grid, -2.0, 0.0)
        assert occupied(grid, 2.3, 0.3)
        assert not occupied(grid, 5.0, 5.0)
    assert not occupied(low, 0.0, 0.0)
    assert not occupied(low, -2.8, 0.0)
    assert occupied(high, 0.0, 0.0)
    assert low.occupied.sum() * low.resolution**2 == pytest.approx(2.0, rel=0.2)


def test_a_kerb_lower_than_the_lidar_is_no_wall_of_a_map() -> None:
    z = np.zeros((101, 101), np.float32)
    z[:, 30:] += 0.1
    z[:, 70:] += 1.0
    world = World("steps", Terrain(HeightField.centered(z, (0.1, 0.1))))
    grid = ground_truth_map(world, 0.3)
    assert not occupied(grid, -2.05, 0.0)
    assert occupied(grid, 1.95, 0.0)
    assert occupied(ground_truth_map(world, 0.05), -2.05, 0.0)
    assert not occupied(grid, 4.0, 0.0)
    for height in (0.0, math.nan):
        with pytest.raises(ConfigError, match="height of a map must be"):
            ground_truth_map(world, height)


def test_the_map_of_a_laser_maps_world_is_that_map(tmp_path: Path) -> None:
    world = build_world(OFFICE)
    folder = write_package(world, tmp_path, formats=("map",))
    found, given = read_map(folder / "map.yaml"), read_map(OFFICE)
    assert found.resolution == given.resolution
    np.testing.assert_allclose(found.origin.as_array(), given.origin.as_array())
    np.testing.assert_array_equal(found.occupied, given.occupied)
    assert (found.known == given.known).mean() > 0.99
    assert not ground_truth_map(world, 3.0).occupied.any()


@pytest.mark.parametrize("source", [pytest.param("medium", marks=pytest.mark.slow), str(OFFICE)])
def test_a_glb_is_the_world_with_its_textures(source: str, tmp_path: Path) -> None:
    world = build_world(source)
    folder = write_package(world, tmp_path, formats=("glb",))
    scene = trimesh.load(folder / f"meshes/{world.name}.glb")
    assert set(scene.geometry) == ({"ground", "walls"} if world.walls is not None else {"ground"})
    assert sum(len(part.faces) for part in scene.geometry.values()) == len(world.file_mesh.faces)
    low, high = world.file_mesh.bounds
    # y up: the world's y is the file's -z.
    np.testing.assert_allclose(
        scene.bounds, ((low[0], low[2], -high[1]), (high[0], high[2], -low[1])), atol=1e-4
    )
    for part in scene.geometry.values():
        assert part.visual.material.baseColorTexture is not None
        assert len(part.visual.uv) == len(part.vertices)


@pytest.mark.parametrize("source", [pytest.param("medium", marks=pytest.mark.slow), str(OFFICE)])
def test_usd_opens_again_with_collision_and_texture(source: str, tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom, UsdPhysics, UsdShade  # type: ignore[import-not-found]

    start = Pose2(3.0, -2.0, 0.5) if source == "medium" else None
    world = build_world(source, BuildOptions(start=start))
    folder = write_package(world, tmp_path, formats=("usd",))
    stage = usd.Stage.Open(str(folder / f"meshes/{world.name}.usd"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetDefaultPrim().GetPath() == "/World"
    meshes = [UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    faces = 0
    for mesh in meshes:
        prim, points = mesh.GetPrim(), np.array(mesh.GetPointsAttr().Get())
        indices = np.array(mesh.GetFaceVertexIndicesAttr().Get())
        assert UsdGeom.Mesh.ValidateTopology(
            mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetFaceVertexCountsAttr().Get(), len(points)
        )[0]
        faces += len(indices) // 3
        assert prim.HasAPI(UsdPhysics.CollisionAPI)
        assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == "none"
        assert len(UsdGeom.PrimvarsAPI(prim).GetPrimvar("st").Get()) == len(points)
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        assert material.GetPrim().HasAPI(UsdPhysics.MaterialAPI)
        texture = UsdShade.Shader(stage.GetPrimAtPath(f"{material.GetPath()}/texture"))
        assert Path(texture.GetInput("file").Get().resolvedPath).is_file()
    assert faces == len(world.file_mesh.faces)
    box = UsdGeom.BBoxCache(usd.TimeCode.Default(), ["default"]).ComputeWorldBound(meshes[0].GetPrim())
    assert box.ComputeAlignedRange().GetMin()[2] == pytest.approx(world.file_mesh.bounds[0, 2], abs=1e-3)
    frame = stage.GetPrimAtPath("/World/starts/start")
    placed = UsdGeom.Xformable(frame).ComputeLocalToWorldTransform(usd.TimeCode.Default())
    pose = world.spawn_poses[0]
    assert tuple(placed.ExtractTranslation())[:2] == pytest.approx((pose.x, pose.y))
    assert placed.TransformDir((1, 0, 0))[1] == pytest.approx(math.sin(pose.yaw))


def test_usd_without_its_library_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    with pytest.raises(ConfigError, match=r"pip install 'lirs-wct\[usd\]'"):
        write_package(build_world("simple"), tmp_path, formats=("usd",))
    assert not list(tmp_path.iterdir())


def test_the_world_of_gz_sim_stands_alone(tmp_path: Path) -> None:
    start = Pose2(3.0, -2.0, 0.5)
    world = build_world("medium", BuildOptions(start=start, window=(0, 0, 20)))
    folder = write_package(world, tmp_path, formats=("dae", "sdf"))
    root = ElementTree.parse(folder / "medium.sdf").getroot()
    assert root.get("version") == "1.9"
    assert root.find("world/include") is None
    for uri in (*root.iter("uri"), *root.iter("albedo_map")):
        assert uri.text is not None
        assert (folder / uri.text).is_file()
    assert root.find("world/model/link/visual/material/pbr/metal/albedo_map") is not None
    plugins = {plugin.get("name") for plugin in root.findall("world/plugin")}
    assert {"gz::sim::systems::Physics", "gz::sim::systems::Sensors", "gz::sim::systems::Imu"} <= plugins
    frames = {frame.get("name"): frame.findtext("pose") for frame in root.findall("world/frame")}
    x, y, z, *_, yaw = (float(value) for value in str(frames["start"]).split())
    assert (x, y, yaw) == pytest.approx((3.0, -2.0, 0.5))
    assert z == pytest.approx(float(world.surface.height_at(3.0, -2.0)), abs=1e-4)
    assert len(frames) == len(world.spawn_poses)
    # Walls and floor have two textures, which the mesh file names.
    both = write_package(build_world(OFFICE), tmp_path, formats=("dae", "sdf"))
    assert ElementTree.parse(both / "office.sdf").getroot().find(".//pbr") is None
