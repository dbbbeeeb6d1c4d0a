"""Converted meshes keep their texture, and what is lost is told; trimesh's own reading is the oracle."""

import itertools
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from lirs_wct.errors import OutputError
from lirs_wct.export.mesh_writer import convert_mesh
from lirs_wct.formats.meshes.reader import TEXTURED, read_textured

PIXELS = np.random.default_rng(5).integers(0, 255, (16, 16, 3), dtype=np.uint8)
CORNERS = np.array([(0, 0, 0), (4, 0, 0), (4, 2, 0), (0, 2, 1), (0, 0, 0), (0, 2, 1), (0, 2, 0)], np.float64)
FACES = [(0, 1, 2), (0, 2, 3), (4, 5, 6)]
UV = np.array([(0, 0), (1, 0), (1, 0.5), (0.125, 0.5), (0.9, 0.9), (0.9, 0.75), (0.5, 0.75)])
"""The first and the fifth vertex are one place with two texture coordinates."""


@pytest.fixture
def glb(tmp_path: Path) -> Path:
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(PIXELS))
    visual = trimesh.visual.TextureVisuals(uv=UV, material=material)
    shape = trimesh.Trimesh(CORNERS, FACES, visual=visual, process=False)
    shape.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    shape.export(tmp_path / "first.glb")
    return tmp_path / "first.glb"


def corners_and_colors(path: Path) -> np.ndarray:
    """(faces, 3, 8) corner positions, texture coordinates and colors at the corners, in a set order."""
    found = read_textured(path)
    mesh = found.mesh.rotated_x(90) if path.suffix == ".glb" else found.mesh
    assert mesh.uv is not None
    assert found.picture is not None
    pixels = np.asarray(found.picture.convert("RGB"))
    at = np.clip((mesh.uv * 16).astype(int), 0, 15)
    colors = pixels[15 - at[:, 1], at[:, 0]]
    rows = np.concatenate((mesh.vertices, mesh.uv, colors), axis=1)[mesh.faces]
    return np.array(sorted(rows.round(4).tolist()))


@pytest.mark.parametrize(("first", "second"), list(itertools.product(TEXTURED, TEXTURED)))
def test_texture_and_coordinates_are_kept(first: str, second: str, glb: Path, tmp_path: Path) -> None:
    given = corners_and_colors(glb)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        convert_mesh(glb, tmp_path / f"one{first}")
        convert_mesh(tmp_path / f"one{first}", tmp_path / "sub folder" / f"my two{second}")
    np.testing.assert_allclose(
        corners_and_colors(tmp_path / "sub folder" / f"my two{second}"), given, atol=2e-4
    )


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_a_texture_that_is_lost_is_told(suffix: str, glb: Path, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=rf"x{suffix}: texture and .* of .*first\.glb are left out"):
        convert_mesh(glb, tmp_path / f"x{suffix}")


def test_colors_of_vertices_that_are_lost_are_told(tmp_path: Path) -> None:
    colors = np.tile((255, 0, 0, 255), (len(CORNERS), 1)).astype(np.uint8)
    trimesh.Trimesh(CORNERS, FACES, vertex_colors=colors, process=False).export(tmp_path / "a.ply")
    with pytest.warns(UserWarning, match=r"x\.dae: the colors of vertices or faces of .*a\.ply are left out"):
        convert_mesh(tmp_path / "a.ply", tmp_path / "x.dae")


def test_a_texture_that_is_not_found_is_told(glb: Path, tmp_path: Path) -> None:
    convert_mesh(glb, tmp_path / "a.dae")
    (tmp_path / "a-texture.png").unlink()
    with pytest.warns(UserWarning, match=r"a\.dae: .* no texture was found"):
        convert_mesh(tmp_path / "a.dae", tmp_path / "b.glb")


def test_a_texture_replaces_no_other_picture(glb: Path, tmp_path: Path) -> None:
    for _ in range(2):  # its own it does
        convert_mesh(glb, tmp_path / "x.obj")
    (tmp_path / "y-texture.png").write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"y-texture\.png: is another picture"):
        convert_mesh(glb, tmp_path / "y.obj")
    assert (tmp_path / "y-texture.png").read_bytes() == b"mine"
    assert not (tmp_path / "y.obj").exists()
