"""The ground in MuJoCo wears what Gazebo's mesh wears, laid the same way."""

from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest

from lirs_wct import BuildOptions, build_world
from lirs_wct.export.mjcf_look import spread
from lirs_wct.export.package import write_package
from lirs_wct.meshing.uv import cube_uv


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


@pytest.mark.parametrize("texture", [None, "checks.png", "checks.jpg"])
def test_the_file_opens_with_its_texture(
    texture: str | None, picture: Path, checks: np.ndarray, tmp_path: Path
) -> None:
    given = None if texture is None else tmp_path / texture
    world = build_world(picture, BuildOptions(texture=given))
    folder = write_package(world, tmp_path / "out", formats=("mjcf",))
    model = mujoco.MjModel.from_xml_path(str(folder / "dunes.xml"))
    ground = model.geom("ground")
    on = model.mat_texid[ground.matid[0], mujoco.mjtTextureRole.mjTEXROLE_RGB]
    assert model.tex(int(on)).name == "ground"
    assert model.tex_width[on] / model.tex_height[on] == pytest.approx(2, rel=0.05)
