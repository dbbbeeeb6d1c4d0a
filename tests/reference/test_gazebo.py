"""Gazebo's own libraries open our files: SDF parser, mesh loader, physics.

The environment variable GAZEBO_CHECK names the folder with the programs sdfchk, meshchk and physchk.
"""

import re
from collections.abc import Callable
from pathlib import Path

import collada
import cv2
import numpy as np
import pytest

from lirs_wct.export.appearance import cube_uv
from lirs_wct.export.mesh_writer import write_mesh
from lirs_wct.formats.gazebo import heightmap_sdf, model_config, model_sdf, world_sdf, write_heightmap
from lirs_wct.formats.meshes.writers import MeshPart, write_parts
from lirs_wct.geometry import HeightField
from lirs_wct.meshing.solid import solid_mesh

pytestmark = pytest.mark.slow


def hills() -> HeightField:
    z = cv2.GaussianBlur(np.random.default_rng(2).random((129, 161)).astype(np.float32), (0, 0), 6)
    return HeightField.centered((z - z.min()) * 20, (0.25, 0.25))


@pytest.fixture(params=["usual", "brief"], autouse=True)
def writer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Each way to write COLLADA."""
    if request.param == "brief":
        monkeypatch.setattr("lirs_wct.formats.meshes.writers.BULK", 0)
    return str(request.param)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A textured model package and its world file beside it."""
    model = tmp_path / "dune"
    (model / "materials/textures").mkdir(parents=True)
    cv2.imwrite(str(model / "materials/textures/sand.png"), np.full((4, 4, 3), 99, np.uint8))
    dae = model / "meshes/dune.dae"
    write_parts(dae, [MeshPart("ground", cube_uv(solid_mesh(hills())), "../materials/textures/sand.png")])
    (model / "model.config").write_text(model_config("dune"))
    (model / "model.sdf").write_text(model_sdf("dune", "meshes/dune.dae"))
    (model / "dune.world").write_text(world_sdf("dune"))
    return model


def test_strict_parser_has_nothing_to_say(gazebo: Callable[..., str], package: Path) -> None:
    said = gazebo("sdfchk", package / "dune.world", package / "model.sdf", MODEL_PATH=package.parent)
    assert "code" not in said
    assert "Warning" not in said
    assert "world[dune] models 1 (dune static 1 links 1 coll type" in said
    assert "model://dune/meshes/dune.dae" in said


def test_mesh_loader_counts_ours_and_finds_the_texture(gazebo: Callable[..., str], package: Path) -> None:
    dae = package / "meshes/dune.dae"
    said = gazebo("meshchk", dae)
    document = collada.Collada(str(dae))
    (shape,) = document.geometries
    n = len(shape.primitives[0].vertex)
    assert n == len(cube_uv(solid_mesh(hills())).vertices)
    check_counts(said, n, 3 * len(solid_mesh(hills()).faces))
    assert str(package) in re.search(r"tex '([^']*)'", said)[1]  # type: ignore[index]
    assert "Unable to find" not in said


def check_counts(said: str, vertices: int, corners: int) -> None:
    """No corner or attribute is lost; a place with several normals may be more vertices than in the file."""
    found = re.search(r" vert (\d+) norm (\d+) idx (\d+) uv (\d+) ", said)
    assert found is not None
    vert, norm, idx, uv = map(int, found.groups())
    assert vert == norm == uv
    assert vertices <= vert < 1.2 * vertices
    assert idx == corners


def test_steep_ground_is_counted_right_too(gazebo: Callable[..., str], tmp_path: Path) -> None:
    """Where the projection changes from triangle to triangle, a place has several texture coordinates."""
    mesh = solid_mesh(HeightField.centered(hills().z * 4, (0.25, 0.25)))
    write_mesh(tmp_path / "a.dae", mesh)
    (shape,) = collada.Collada(str(tmp_path / "a.dae")).geometries
    n = len(shape.primitives[0].vertex)
    assert n > 1.05 * len(mesh.vertices)
    check_counts(gazebo("meshchk", tmp_path / "a.dae"), n, 3 * len(mesh.faces))


def test_a_sphere_rests_on_the_ground(gazebo: Callable[..., str], package: Path) -> None:
    surface = hills()
    start = np.unravel_index(surface.z[20:-20, 20:-20].argmin(), (89, 121))
    x = surface.origin[0] + (start[1] + 20) * surface.cell[0]
    y = surface.bounds[3] - (start[0] + 20) * surface.cell[1]
    drop = float(surface.height_at(x, y)) + 1.0
    said = gazebo("physchk", "dartsim", package / "meshes/dune.dae", x, y, drop, 5000)
    px, py, pz = map(float, re.search(r"final +(\S+) +(\S+) +(\S+)", said).groups())  # type: ignore[union-attr]
    around = np.linspace(-0.3, 0.3, 61)
    gx, gy = np.meshgrid(px + around, py + around)
    distance = np.sqrt((gx - px) ** 2 + (gy - py) ** 2 + (surface.height_at(gx, gy) - pz) ** 2).min()
    assert distance == pytest.approx(0.3, abs=0.02)


def test_heightmap_model(gazebo: Callable[..., str], tmp_path: Path) -> None:
    surface, model = hills(), tmp_path / "dune"
    write_heightmap(model / "materials/textures/heights.png", surface)
    (model / "model.config").write_text(model_config("dune"))
    (model / "model.sdf").write_text(heightmap_sdf("dune", surface, "materials/textures/heights.png"))
    (model / "dune.world").write_text(world_sdf("dune"))
    said = gazebo("sdfchk", model / "dune.world", MODEL_PATH=tmp_path)
    assert "code" not in said
    assert "hm model://dune/materials/textures/heights.png size 40 32 " in said
    said = gazebo("meshchk", model / "materials/textures/heights.png")
    assert "load 0 w 257 h 257" in said
    assert " min 0 max 2" in said
