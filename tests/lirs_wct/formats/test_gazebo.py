"""Gazebo's files: models, worlds, and heightmaps of a surface."""

import math
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.formats.gazebo import (
    Layer,
    flat_normals,
    heightmap_sdf,
    model_config,
    model_sdf,
    world_sdf,
    write_heightmap,
)
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2, Pose3, overview


def test_model_is_seen_and_felt_as_the_same_mesh() -> None:
    model = ET.fromstring(model_sdf("dune", "meshes/dune.dae"))
    uris = {kind: model.findtext(f".//{kind}/geometry/mesh/uri") for kind in ("visual", "collision")}
    assert uris == dict.fromkeys(uris, "model://dune/meshes/dune.dae")
    assert model.findtext("model/static") == "true"


def test_world_includes_model_light_physics_and_gravity_but_no_plane() -> None:
    text = world_sdf("dune")
    world = ET.fromstring(text)
    assert world.findtext("world/include/uri") == "model://dune"
    assert world.findtext("world/gravity") == "0 0 -9.80665"
    assert world.findtext("world/physics/max_step_size") == "0.001"
    assert world.findtext("world/physics/real_time_update_rate") == "1000"
    assert world.find("world/light") is not None
    assert "plane" not in text


def test_the_window_opens_on_a_view_of_the_world() -> None:
    view = overview((-25, -20, 0), (25, 20, 6), 0.8)
    pose = ET.fromstring(world_sdf("dune", view=view)).findtext("world/gui/camera/pose")
    x, y, z, roll, pitch, yaw = map(float, pose.split())
    assert (x, y, z) == pytest.approx(view.position, rel=1e-5)
    assert z > 6
    assert roll == 0
    # Gazebo's camera looks along its x axis: towards the middle.
    ahead = (math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch))
    distance = math.dist(view.position, (0, 0, 3))
    assert [p + distance * a for p, a in zip(view.position, ahead, strict=True)] == pytest.approx(
        (0, 0, 3), abs=1e-3
    )
    assert "<gui>" not in world_sdf("dune")


def test_a_comment_says_how_a_robot_is_set_down_at_each_start() -> None:
    starts = [Pose3.from_pose2(Pose2(3, -4, 1.5), 1.25), Pose3.from_pose2(Pose2(-1, 2, -3), 0.5)]
    text = world_sdf("dune", starts=starts)
    (comment,) = re.findall("<!--(.*?)-->", text, re.S)
    assert "spawn_entity.py -entity robot -file robot.urdf -x 3.000 -y -4.000 -z 1.250 -Y 1.5000" in comment
    assert "gz model -f robot.sdf -m robot -x 3.000 -y -4.000 -z 1.250 -Y 1.5000" in comment
    assert "-x -1.000 -y 2.000 -z 0.500 -Y -3.0000" in comment
    assert ET.fromstring(text).find("world/include") is not None
    assert "<!--" not in world_sdf("dune")


def test_config_names_the_sdf_and_escapes() -> None:
    config = ET.fromstring(model_config("a<b&c"))
    assert config.findtext("sdf") == "model.sdf"
    assert config.findtext("name") == "a<b&c"
    assert config.findtext("author/name")


def test_names_with_spaces_are_refused() -> None:
    for make in (lambda: model_sdf("my dune", "dune.dae"), lambda: world_sdf("a b")):
        with pytest.raises(ConfigError, match="no names with spaces"):
            make()


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
