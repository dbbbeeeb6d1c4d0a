"""Previews stand for the world that is built, and the package is the one of `lirs-wct build`."""

import io
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.construction import PREVIEW_NODES, Uploads, build, preview, zip_folder
from lirs_validation.gui.scene import world_glb
from lirs_wct import build_world, write_package
from lirs_wct.errors import ConfigError, WctError
from lirs_wct.sources.source import BuildOptions


@pytest.fixture(scope="module")
def dunes(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A picture of dunes, 400 x 300 pixels of 16 bits."""
    noise = np.random.default_rng(1).standard_normal((300, 400)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 15)
    path = tmp_path_factory.mktemp("dunes") / "dunes.png"
    cv2.imwrite(str(path), (65535 * (smooth - smooth.min()) / np.ptp(smooth)).astype(np.uint16))
    return str(path)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"size": 30.0, "height": 4.0, "scale": (1.0, 2.0, 3.0)},
        {"invert": True, "z_scale": 2.0, "resolution": 0.1, "crop": (50, 20, 200, 250)},
        {"window": (5.0, -5.0, 20.0)},
        {"resize": (200, 300)},
    ],
)
def test_a_preview_is_the_world_on_fewer_nodes(tmp_path: Path, dunes: str, options: dict[str, Any]) -> None:
    chosen = BuildOptions(**options)
    coarse = preview(dunes, chosen, tmp_path).world.surface
    fine = build_world(dunes, chosen).surface
    assert max(coarse.shape) <= PREVIEW_NODES
    spacing = max(coarse.cell)
    np.testing.assert_allclose(coarse.bounds, fine.bounds, atol=spacing if "window" in options else 1e-6)
    x, y = np.meshgrid(np.linspace(-4, 4, 50), np.linspace(-4, 4, 50))
    difference = coarse.height_at(x, y) - fine.height_at(x, y)
    inside = np.isfinite(difference)
    assert inside.any()
    difference -= np.median(difference[inside]) if "window" in options else 0.0  # its lowest node is z = 0
    assert np.abs(difference[inside]).max() < 0.05 * fine.relief


def test_the_package_is_that_of_the_command_line(tmp_path: Path, picture: Path) -> None:
    options = BuildOptions(height=3.0, max_error=0.05, name="hill")
    shown = build(str(picture), options, tmp_path / "page")
    assert shown.package is not None
    folder = write_package(build_world(picture, options), tmp_path / "worlds")
    mine, theirs = ({p.name: p.read_bytes() for p in f.rglob("*.*")} for f in (shown.package, folder))
    assert mine.keys() == theirs.keys()
    assert all(mine[name] == theirs[name] for name in mine if not name.endswith((".npz", ".config")))
    assert dict(shown.facts)["triangles"] == f"{len(shown.world.mesh.faces)}"
    names = zipfile.ZipFile(io.BytesIO(zip_folder(folder))).namelist()
    assert "hill/world.json" in names
    assert all(name.startswith("hill/") for name in names)


def test_another_file_of_the_same_name_is_read_anew(tmp_path: Path, picture: Path) -> None:
    scenarios, config = ScenarioCache(), RunConfig(source=str(picture))
    before = preview(str(picture), BuildOptions(), tmp_path).world.surface.z
    driven = scenarios.scenario(config).world.surface.z
    pixels = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
    assert pixels is not None
    cv2.imwrite(str(picture), 255 - pixels)
    scenarios.clear()
    after = preview(str(picture), BuildOptions(), tmp_path).world.surface.z
    np.testing.assert_allclose(after, 6.0 - before, atol=0.05)
    np.testing.assert_allclose(scenarios.scenario(config).world.surface.z, 6.0 - driven, atol=0.05)


@pytest.mark.parametrize("most", [2_000, 50_000])
def test_the_browser_is_given_no_more_than_it_can_show(dunes: str, most: int) -> None:
    world = build_world(dunes, BuildOptions(size=(50.0, 50.0)))
    content, triangles = world_glb(world, most)
    # Skirt and base come on top of the surface.
    assert triangles <= most + 12 * most**0.5
    scene = trimesh.load(io.BytesIO(content), file_type="glb", force="mesh")
    np.testing.assert_allclose(scene.bounds[:, :2], ((-25, -25), (25, 25)), atol=1e-4)
    assert scene.visual.material.baseColorTexture is not None


def test_a_budget_of_triangles_is_shown_as_it_is(tmp_path: Path, dunes: str) -> None:
    world = build_world(dunes, BuildOptions(max_triangles=900))
    _, triangles = world_glb(world, 5_000)
    assert triangles == len(world.mesh.faces) <= 900
    with pytest.raises(ConfigError):
        build(dunes, BuildOptions(), tmp_path, formats=())


def test_an_uploaded_map_is_its_yaml_and_its_picture() -> None:
    uploads = Uploads()
    pixels = np.full((60, 80), 254, np.uint8)
    pixels[:2] = pixels[-2:] = pixels[:, :2] = pixels[:, -2:] = 0
    yaml = b"image: /home/me/maps/my room.pgm\nresolution: 0.1\norigin: [1, 2, 0]\n"
    try:
        path = uploads.add("room.yaml", yaml)
        with pytest.raises(WctError, match=r"my_room\.pgm is not there"):
            preview(str(path), BuildOptions(), uploads.folder)
        uploads.add("my room.pgm", cv2.imencode(".pgm", pixels)[1].tobytes())
        shown = preview(str(path), BuildOptions(wall_height=1.5), uploads.folder)
        assert shown.world.walls is not None
        assert shown.world.walls.height == 1.5
        assert shown.world.surface.bounds == pytest.approx((1.0, 2.0, 9.0, 8.0))
        assert dict(shown.facts)["walls"] == "544 of 4800 cells of 0.1 m, 1.5 m high"
    finally:
        uploads.close()


def test_a_preview_names_unusual_figures_as_a_build_does(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((9, 9), 7, np.uint8))
    for make in (preview, build):
        with pytest.warns(UserWarning, match=r"flat\.png: the ground is flat, 0 m of relief on 50 m"):
            make(str(tmp_path / "flat.png"), BuildOptions(), tmp_path / "page")
