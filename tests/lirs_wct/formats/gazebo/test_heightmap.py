from pathlib import Path
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest

from lirs_wct.formats.gazebo import Layer, flat_normals, heightmap_sdf, write_heightmap
from lirs_wct.geometry.heightfield import HeightField


def hills(rows: int, cols: int) -> HeightField:
    z = cv2.GaussianBlur(np.random.default_rng(4).random((rows, cols)).astype(np.float32), (0, 0), 4)
    return HeightField.centered(z - z.min(), (0.5, 0.25))


def picture(folder: Path, surface: HeightField) -> np.ndarray:
    write_heightmap(folder / "a.png", surface)
    return cv2.imread(str(folder / "a.png"), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize(("longest", "side"), [(2, 17), (129, 129), (130, 257), (5000, 4097)])
def test_level_ground(longest: int, side: int, tmp_path: Path) -> None:
    pixels = picture(tmp_path, HeightField.centered(np.zeros((2, longest), np.float32), (1, 1)))
    assert pixels.shape == (side, side)
    assert not pixels.any()


def test_pixels_are_the_surface(tmp_path: Path) -> None:
    surface = hills(60, 100)
    pixels = picture(tmp_path, surface)
    assert pixels.shape == (129, 129)
    assert pixels.dtype == np.uint8
    w, s, e, n = surface.bounds
    x, y = np.meshgrid(np.linspace(w, e, 129), np.linspace(n, s, 129))
    assert np.abs(pixels / 255 * surface.relief - surface.height_at(x, y)).max() < surface.relief / 100


def test_sdf_has_the_meters() -> None:
    surface = hills(60, 101)
    model = ET.fromstring(heightmap_sdf("dune", surface, "materials/textures/dune_heights.png"))
    for kind in ("visual", "collision"):
        heightmap = model.find(f".//{kind}/geometry/heightmap")
        assert heightmap.findtext("uri") == "model://dune/materials/textures/dune_heights.png"
        size = [float(v) for v in (heightmap.findtext("size") or "").split()]
        assert size == pytest.approx([50.0, 14.75, surface.relief])
        assert heightmap.findtext("pos") == "0 0 0"


def test_what_it_wears_has_a_flat_normal_map_of_its_own() -> None:
    """The color picture as normals lights the ground from everywhere."""
    layer = Layer("a.png", "a-normal.png", 12.5)
    model = ET.fromstring(heightmap_sdf("dune", hills(60, 101), "h.png", layer))
    texture = model.find(".//visual/geometry/heightmap/texture")
    assert {part.tag: part.text for part in texture} == {
        "diffuse": "model://dune/a.png",
        "normal": "model://dune/a-normal.png",
        "size": "12.5",
    }
    up = flat_normals()[..., ::-1].reshape(-1, 3) / 255.0 * 2 - 1
    np.testing.assert_allclose(up, [[0, 0, 1]] * len(up), atol=0.01)
