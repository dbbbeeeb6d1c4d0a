"""Names of worlds in any script."""

import warnings
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
import trimesh

from lirs_wct.errors import SourceError
from lirs_wct.export.package import write_package
from lirs_wct.formats.map_server import read_map
from lirs_wct.sources.build import build_world
from lirs_wct.sources.source import BuildOptions, find_source


@pytest.mark.parametrize(
    ("given", "name"),
    [("ünï ćode 世界", "uni_code"), ("世界", "world"), ("שלום 😀", "world"), ('a\'b "c"', "a_b_c")],
)
def test_a_name_is_made_legal_and_the_change_of_letters_is_said(given: str, name: str) -> None:
    with warnings.catch_warnings(record=True, action="always") as said:
        assert find_source("simple", BuildOptions(name=given)).name == name
    told = [f"{given}: the world is named {name}; "] if not given.isascii() else []
    assert [str(w.message)[: len(told[0])] for w in said] == told if told else not said


def test_every_file_of_a_world_of_any_name_and_folder_loads(tmp_path: Path) -> None:
    source = tmp_path / "ünï ćode 世界 'q\" 😀 שלום.png"
    picture = np.add.outer(np.arange(9), np.arange(9)).astype(np.uint8)
    source.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    with pytest.warns(UserWarning, match="the world is named uni_code_q"):
        world = build_world(source, BuildOptions(size=20, height=1))
    folder = write_package(
        world, tmp_path / "výstup 世界", formats=["dae", "stl", "sdf", "mjcf", "obj", "glb", "map"]
    )
    assert folder.name == "uni_code_q"
    for suffix in ("stl", "dae", "obj", "glb"):
        (mesh,) = folder.rglob(f"*.{suffix}")
        assert len(trimesh.load_mesh(mesh).faces) > 0
    mujoco.MjModel.from_xml_path(str(folder / "uni_code_q.xml"))
    (yaml,) = folder.rglob("*.yaml")
    assert read_map(yaml).free.any()
    assert build_world(folder).name == "uni_code_q"


@pytest.mark.parametrize("file", ["map.yaml", "map.yml", "Map.YAML", "map.pgm", "map.stl", "map.log.gz"])
def test_a_file_called_map_is_named_after_its_folder(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("first floor", "cellar"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / file).write_bytes(b"")
    monkeypatch.chdir(tmp_path / "cellar")
    others = {
        Path(file): "cellar",
        Path("../first floor", file): "first_floor",
        tmp_path / "cellar" / file: "cellar",
    }
    assert {path: find_source(path, BuildOptions()).name for path in others} == others
    assert find_source(file, BuildOptions(name="hall")).name == "hall"
    other = Path(f"roadmap{Path(file).suffix}")
    other.write_bytes(b"")
    assert find_source(other, BuildOptions()).name == "roadmap"
    Path("map").mkdir()
    Path("map/world.json").write_text("{}")
    assert find_source("map", BuildOptions()).name == "map"


def test_a_similar_bundled_name_is_suggested() -> None:
    with pytest.raises(SourceError, match=r"simpel: no such file .*; did you mean simple\?$"):
        find_source("simpel", BuildOptions())


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("scene.gltf", "is a glTF scene in several files, which is not read: save it as .glb"),
        ("scene.FBX", "is a scene of another 3D program, which is not read: export it as .glb"),
        ("part.step", "is a CAD model, which is not read: export it as .stl"),
        ("scan.e57", "is a point cloud, which is not read: convert it to .las"),
        ("map.bt", "is an OctoMap, which is not read: octree2pointcloud"),
        ("house.world", "is a description in XML, which is not read: give the mesh"),
    ],
)
def test_the_way_to_a_file_that_is_read(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"\0")
    with pytest.raises(SourceError, match=rf"^{tmp_path / name}: {words}"):
        find_source(tmp_path / name, BuildOptions())
