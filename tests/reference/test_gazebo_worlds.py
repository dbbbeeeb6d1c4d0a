"""Gazebo's own libraries open whole worlds: the bundled ones and real pictures, maps and meshes.

The environment variable GAZEBO_CHECK names the folder with the programs sdfchk, meshchk and physchk.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import collada
import numpy as np
import pytest
import trimesh

from lirs_wct import BuildOptions, World, build_world
from lirs_wct.export.package import write_package
from lirs_wct.navigation import spawn_poses

pytestmark = pytest.mark.slow

RADIUS = 0.3

WORLDS: dict[str, dict[str, Any]] = {
    "simple": {"max_error": 0.01},
    "medium": {"max_error": 0.01},
    "advanced": {"max_error": 0.01, "terrain": "heightmap"},
    "height/pydelatin__fuji.png": {"grayscale": True, "max_error": 0.02},
    "height/gz-common__dem_moon.tif": {},
    "height/vrc_driving_heightmap.png": {"deterrace": True, "max_triangles": 50_000},
    "maps/turtlebot3/map.yaml": {},
    "maps/turtlebot_apps/willow-2010-02-18-0.10.yaml": {"unknown": "hole", "speckle": 3},
    "stl/unitree_mujoco__terrain.STL": {},
}


@pytest.fixture(scope="module", params=WORLDS)
def package(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[World, Path, Path | None]:
    """A world, its folder, and its folder as a heightmap model where it is to be one."""
    options = dict(WORLDS[request.param])
    source: str | Path = request.param
    if "/" in request.param:
        source = request.getfixturevalue("shared_data") / request.param
    heightmap = options.pop("terrain", "solid") == "heightmap"
    world = build_world(source, BuildOptions(**options))
    folder = write_package(world, tmp_path_factory.mktemp("solid"))
    other = (
        write_package(world, tmp_path_factory.mktemp("map"), formats=("sdf",), terrain="heightmap")
        if heightmap
        else None
    )
    return world, folder, other


def test_the_strict_parser_has_nothing_to_say(
    gazebo: Callable[..., str], package: tuple[World, Path, Path | None]
) -> None:
    world, *folders = package
    for folder in filter(None, folders):
        for ending in ("world", "sdf"):
            said = gazebo("sdfchk", folder / f"{world.name}.{ending}", MODEL_PATH=folder.parent)
            assert "code" not in said
            assert "Warning" not in said
            assert f"world[{world.name}] models 1 ({world.name} static 1 links 1 coll type" in said


def test_the_mesh_loader_counts_ours_and_finds_the_texture(
    gazebo: Callable[..., str], package: tuple[World, Path, Path | None]
) -> None:
    world, folder, _ = package
    dae = folder / "meshes" / f"{world.name}.dae"
    said = gazebo("meshchk", dae)
    (shape,) = collada.Collada(str(dae)).geometries
    n = len(shape.primitives[0].vertex)
    found = re.search(r" vert (\d+) norm (\d+) idx (\d+) uv (\d+) ", said)
    assert found is not None
    vert, norm, idx, uv = map(int, found.groups())
    # A place with several normals may be more vertices than in the file; none is lost.
    assert n <= vert == norm == uv
    assert idx == 3 * len(world.file_mesh.faces)
    assert "Unable to find" not in said
    textures = [Path(found).resolve() for found in re.findall(r"tex '([^']*)'", said)]
    endings = ("", "-walls") if world.walls is not None else ("",)
    names = [f"{world.name}{ending}.png" for ending in endings]
    assert textures == [(folder / "materials/textures" / name).resolve() for name in names]
    low, high = (np.array(m.split()[:3], float) for m in re.search(r"min (.*) max (.*) mat", said).groups())  # type: ignore[union-attr]
    np.testing.assert_allclose((low, high), world.file_mesh.bounds, rtol=1e-5, atol=2e-5)


def test_a_sphere_rests_on_the_mesh(
    gazebo: Callable[..., str], package: tuple[World, Path, Path | None]
) -> None:
    world, folder, _ = package
    free = world.traversable(clearance=0.4, max_slope=0.2, resolution=max(0.1, world.surface.size[0] / 500))
    start = spawn_poses(free)[0]
    drop = float(world.surface.height_at(start.x, start.y)) + 0.6
    dae = folder / "meshes" / f"{world.name}.dae"
    said = gazebo("physchk", "dartsim", dae, start.x, start.y, drop, 3000)
    at = np.array(re.search(r"final +(\S+) +(\S+) +(\S+)", said).groups(), float)  # type: ignore[union-attr]
    mesh = trimesh.Trimesh(world.file_mesh.vertices, world.file_mesh.faces, process=False)
    _, distance, _ = trimesh.proximity.closest_point(mesh, at[None])
    assert distance[0] == pytest.approx(RADIUS, abs=0.02)
    assert at[2] > float(world.surface.height_at(at[0], at[1]))


def test_whole_and_true_to_the_source(package: tuple[World, Path, Path | None]) -> None:
    """The same, without Gazebo: closed, the volume of its own surface, the source's integral of heights."""
    world = package[0]
    mesh = trimesh.Trimesh(world.file_mesh.vertices, world.file_mesh.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(world.file_mesh.volume, rel=1e-6)
    if world.kind != "terrain":
        return
    width, depth = world.surface.size
    z = world.surface.z.astype(np.float64)
    # The integral of a surface that is linear on triangles split from south-west to north-east.
    sw, se, nw, ne = z[1:, :-1], z[1:, 1:], z[:-1, :-1], z[:-1, 1:]
    per_cell = world.surface.cell[0] * world.surface.cell[1] / 6
    integral = float((2 * sw + 2 * ne + se + nw).sum()) * per_cell
    below = -world.file_mesh.bounds[0, 2] * width * depth
    budget = (world.file_options.max_error or 0.0) * width * depth
    if world.export_options.max_triangles is None:
        assert world.file_mesh.volume == pytest.approx(integral + below, abs=budget + 1e-6 * integral)
