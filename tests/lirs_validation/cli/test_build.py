"""Every option of `build` at the command line does what it says; `info` and `convert`."""

import math
import re
import shlex
import shutil
from pathlib import Path
from xml.etree import ElementTree

import cv2
import mujoco
import numpy as np
import pytest
import trimesh

from lirs_validation.metrics.world_geometry import STRIP, _slopes, mesh_error
from lirs_wct import World
from lirs_wct.files import MANIFEST
from lirs_wct.formats import MESHES
from lirs_wct.formats.meshes.reader import read_upright
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2
from tests.command_line import run_command


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a smooth picture, a map and a picture for a texture."""
    z = cv2.GaussianBlur(np.random.default_rng(4).random((48, 64)).astype(np.float32), (0, 0), 4)
    z = (z - z.min()) / np.ptp(z)
    cv2.imwrite(str(tmp_path / "hill.png"), np.rint(z * 65535).astype(np.uint16))
    cv2.imwrite(str(tmp_path / "stairs.png"), np.rint(z * 20).astype(np.uint8) * 12)
    cv2.imwrite(str(tmp_path / "my grass.JPG"), np.full((8, 8, 3), (30, 160, 60), np.uint8))
    plan = np.full((40, 60), 254, np.uint8)
    plan[:, :20] = 205
    plan[10:20, 40] = plan[30, 50] = 0
    cv2.imwrite(str(tmp_path / "room.pgm"), plan)
    (tmp_path / "room.yaml").write_text(
        "image: room.pgm\nresolution: 0.1\norigin: [-1, -2, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def wct(*arguments: str) -> None:
    assert run_command(*arguments) == 0


def built(source: str, *options: str, to: str = "hfield") -> World:
    wct("build", source, "-o", "out", "--name", "w", "--to", to, *options)
    return World.load("out/w")


def files() -> set[str]:
    found = {p.relative_to("out/w").as_posix() for p in Path("out/w").rglob("*") if p.is_file()}
    return found - {MANIFEST}


def roughness(surface: HeightField) -> float:
    return float(np.abs(np.diff(surface.z, 2)).mean())


def test_filters_reach_the_picture(folder: Path) -> None:
    plain = built("hill.png").surface
    assert built("hill.png", "--option", "crop=8,4,32,16").surface.shape == (16, 32)
    resized = built("hill.png", "--option", "resize=96,80").surface
    assert (resized.shape, resized.size) == ((80, 96), pytest.approx(plain.size))
    smooth = built("hill.png", "--smoothing", "2").surface
    assert roughness(smooth) < roughness(plain)
    sharp = built("hill.png", "--smoothing", "2", "--sharpness", "1.5").surface
    assert roughness(sharp) > roughness(smooth)


def test_to_writes_only_what_is_asked(folder: Path) -> None:
    always = {"world.json", "world.npz"}
    built("hill.png", to="stl")
    assert files() == always | {"meshes/w.stl"}
    built("hill.png", to="hfield")
    assert files() == always | {"w.hfield"}
    built("hill.png", to="obj")
    assert files() == always | {"meshes/w.obj", "meshes/w.mtl", "materials/textures/w.png"}
    built("hill.png", to="stl,sdf")
    assert files() == always | {"meshes/w.stl", "model.sdf", "model.config", "w.world", "w.sdf"}
    assert "meshes/w.stl" in Path("out/w/model.sdf").read_text()


def test_a_budget_limits_every_mesh_file(folder: Path) -> None:
    full = built("hill.png", "--height", "3", to="stl,dae,obj")
    world = built("hill.png", "--height", "3", "--max-error", "0.05", to="stl,dae,obj")
    counts = {len(read_upright(Path(f"out/w/meshes/w.{kind}")).faces) for kind in ("stl", "dae", "obj")}
    assert counts == {len(world.mesh.faces)}
    assert len(world.mesh.faces) < 0.4 * len(full.mesh.faces)
    assert len(built("hill.png", "--option", "max-triangles=500").mesh.faces) <= 500


def test_rotate_x_turns_the_files_and_nothing_else(folder: Path) -> None:
    world = built("hill.png", "--height", "3", "--rotate-x", "90", to="stl,dae")
    upright = world.mesh.bounds
    for kind in ("stl", "dae"):
        turned = read_upright(Path(f"out/w/meshes/w.{kind}")).bounds
        np.testing.assert_allclose(turned[:, 2], upright[:, 1], atol=1e-4)
        np.testing.assert_allclose(turned[:, 1], -upright[::-1, 2], atol=1e-4)
    assert world.surface.relief == pytest.approx(3)


def test_a_texture_is_copied_named_and_tiled(folder: Path) -> None:
    built("hill.png", "--texture", "my grass.JPG", "--option", "texture-size=5", to="dae,sdf")
    kept = Path("out/w/materials/textures/w.jpg")
    assert kept.read_bytes() == Path("my grass.JPG").read_bytes()
    assert "../materials/textures/w.jpg" in Path("out/w/meshes/w.dae").read_text()
    loaded = trimesh.load_scene("out/w/meshes/w.dae")
    uv = np.concatenate([g.visual.uv for g in loaded.geometry.values()])
    assert np.ptp(uv[:, 0]) == pytest.approx(50 / 5, rel=0.3)
    again = built("out/w", to="dae")
    assert again.export_options.texture is not None
    assert again.export_options.texture.read_bytes() == Path("my grass.JPG").read_bytes()
    assert again.export_options.texture_size == 5


def test_options_without_effect_are_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    built("room.yaml", "--invert", "--size", "3")
    told = capsys.readouterr().err
    assert "room.yaml: --size, --invert have no effect on a laser map" in told
    built("hill.png", "--option", "speckle=3")
    assert "speckle has no effect on a picture of a terrain" in capsys.readouterr().err
    built("room.yaml", "--max-error", "0.1")
    assert "room.yaml: --max-error has no effect" in capsys.readouterr().err
    built("hill.png", "--size", "20", "--window", "0,0,10", "--max-error", "0.1")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("command", ["build", "info"])
def test_a_window_beyond_the_world_is_told_by_every_command(
    command: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wct(command, "hill.png", "--size", "20", "--window", "5,0,40")
    assert "hill.png: --window 5,0,40 reaches beyond the world, 20 x 14.92 m of it are left" in (
        capsys.readouterr().err
    )


def test_a_picture_beside_its_yaml_is_that_laser_map(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world = built("room.pgm")
    assert "room.pgm: read as the laser map that room.yaml beside it says it is" in capsys.readouterr().err
    assert world.kind == "map"
    assert world.truth is not None
    assert (world.truth.resolution, world.truth.origin) == (0.1, Pose2(-1, -2))
    assert built("room.pgm", "--kind", "map").truth.resolution == 0.1
    assert built("room.pgm", "--kind", "map", "--resolution", "0.2").truth.resolution == 0.2
    assert built("room.pgm", "--kind", "picture").kind == "terrain"
    Path("hill.yaml").write_text("image: other.png\nresolution: 1\norigin: [0, 0, 0]\n")
    assert built("hill.png").kind == "terrain"
    Path("hill.yaml").write_text("these: are notes\n")
    capsys.readouterr()
    assert built("hill.png").kind == "terrain"
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("source", ["hill.png", "room.yaml", "ball.ply"])
def test_the_last_lines_open_the_world_with_the_files_that_they_list(
    source: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trimesh.creation.icosphere(1, 3.0).export("ball.ply")
    wct("build", source, "-o", "my worlds", "--name", "w")
    gazebo, gz, mujoco_files, viewer = capsys.readouterr().out.splitlines()[-4:]
    programs = {gz: ("gz", "sim", ""), viewer: (viewer.split()[0], "-m", "mujoco.viewer", "--mjcf=")}
    assert shutil.which(viewer.split()[0])
    for line, listed in ((gz, gazebo), (viewer, mujoco_files)):
        *words, last = shlex.split(line)
        *expected, before = programs[line]
        assert words == expected
        model = Path(last.removeprefix(before))
        alone = folder / "alone" / model.name
        for name in (model.name, *re.sub(r"^open in \w+, with (.*):$", r"\1", listed).split(", ")):
            (alone / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(model.parent / name, alone / name)
        if model.suffix == ".xml":
            mujoco.MjModel.from_xml_path(str(alone / model.name))
            continue
        mesh = alone / ElementTree.parse(alone / model.name).findtext(".//visual//uri", "")
        assert trimesh.load_scene(mesh).geometry
        textures = re.findall(r"<init_from>(\.\./[^<]+)<", mesh.read_text())
        assert textures
        assert all((mesh.parent / texture).is_file() for texture in textures)


def test_only_what_was_written_is_opened(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for to, programs in (("hfield", []), ("stl,sdf", ["Gazebo"]), ("mjcf", ["MuJoCo"])):
        built("hill.png", to=to)
        assert re.findall(r"^open in (\w+), with", capsys.readouterr().out, re.MULTILINE) == programs


BAD = {
    "empty": (("build", "empty.png"), "empty.png: "),
    "1x1": (("build", "dot.png"), "1x1"),
    "all NaN": (("build", "nan.tif"), "nan.tif: "),
    "no image": (("build", "lost.yaml"), "lost.yaml: "),
    "both sizes": (("build", "hill.png", "--size", "3", "--resolution", "1"), "--size, --resolution"),
    "size": (("build", "hill.png", "--size", "3,4,5"), "--size must be W[,H]"),
    "as": (("build", "hill.png", "--kind", "mesh"), "--kind must be picture or map"),
    "both budgets": (
        ("build", "hill.png", "--max-error", "1", "--option", "max-triangles=99"),
        "max-error, max-triangles",
    ),
    "crop": (("build", "hill.png", "--option", "crop=0,0,2.5,3"), "--option crop must be X,Y,W,H, got"),
    "crop outside": (
        ("build", "hill.png", "--option", "crop=60,0,9,9"),
        "hill.png: image is 64x48 px, a crop",
    ),
    "resize": (("build", "hill.png", "--option", "resize=9"), "--option resize must be W,H, got"),
    "scale": (("build", "hill.png", "--scale", "1,2"), "--scale must be S or SX,SY,SZ"),
    "denoise": (("build", "hill.png", "--option", "denoise=magic"), "median or bilateral"),
    "unknown": (("build", "hill.png", "--option", "unknown=sea"), "unknown must be floor, wall or hole"),
    "speckle": (("build", "hill.png", "--option", "speckle=-1"), "speckle must be at least 0 cells"),
    "smoothing": (("build", "hill.png", "--smoothing", "0"), "smoothing must be a finite number above 0"),
    "format": (
        ("build", "hill.png", "--to", "dae,fbx"),
        "unknown format 'fbx'; legal: dae, glb, hfield, map",
    ),
    "sdf alone": (("build", "hill.png", "--to", "sdf"), "ask for dae or stl as well"),
    "terrain": (("build", "hill.png", "--terrain", "prisms"), "--terrain must be solid or heightmap"),
    "no texture": (("build", "hill.png", "--texture", "gone.png"), "gone.png: cannot be read"),
    "texture is none": (("build", "hill.png", "--texture", "room.yaml"), "room.yaml: a texture must be"),
    "broken texture": (("build", "hill.png", "--texture", "cut.png"), "cut.png: "),
    "empty mesh": (("build", "empty.stl"), "empty.stl: "),
    "no mesh": (("convert", "hill.png", "x.stl"), "hill.png: not a mesh that is read; legal: .stl, .dae"),
    "convert to": (("convert", "box.stl", "x.step"), "x.step: not a mesh that is written; legal: .stl, .dae"),
    "convert none": (("convert", "gone.stl", "x.dae"), "gone.stl: no such file"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_option_is_one_line_that_names_it(
    case: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("empty.stl", "empty.png"):
        (folder / name).write_bytes(b"")
    cv2.imwrite("dot.png", np.zeros((1, 1), np.uint8))
    cv2.imwrite("nan.tif", np.full((9, 9), np.nan, np.float32))
    (folder / "lost.yaml").write_text((folder / "room.yaml").read_text().replace("room.pgm", "nowhere.pgm"))
    (folder / "cut.png").write_bytes((folder / "hill.png").read_bytes()[:900])
    trimesh.creation.box((1, 2, 3)).export("box.stl")
    before = sorted(folder.rglob("*"))
    arguments, expected = BAD[case]
    assert run_command(*arguments) == 2
    told = capsys.readouterr().err
    assert expected in told
    assert len(told.strip().splitlines()) == 1, told
    assert sorted(folder.rglob("*")) == before


def test_two_sources_of_one_name_do_not_replace_each_other(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "other").mkdir()
    for name in ("room.yaml", "room.pgm"):
        (folder / "other" / name).write_bytes((folder / name).read_bytes())
    wct("build", "room.yaml", "-o", "out", "--to", "hfield")
    (folder / "out/room/notes.txt").write_text("mine")
    before = {p: p.read_bytes() for p in (folder / "out").rglob("*") if p.is_file()}
    assert run_command("build", "other/room.yaml", "-o", "out", "--to", "hfield") == 2
    told = capsys.readouterr().err.strip()
    assert told.startswith(f"lirs-wct: out/room: holds the world of another source, {folder / 'room.yaml'}; ")
    assert "--name" in told
    assert len(told.splitlines()) == 1
    assert {p: p.read_bytes() for p in (folder / "out").rglob("*") if p.is_file()} == before
    # The same source again, and another one under a name that was given, replace what was built.
    wct("build", "./room.yaml", "-o", "out", "--to", "hfield")
    wct("build", "other/room.yaml", "-o", "out", "--to", "hfield", "--name", "room")
    wct("build", "out/room", "-o", "out", "--to", "hfield")
    assert World.load("out/room").source == str(folder / "other/room.yaml")
    assert (folder / "out/room/notes.txt").read_text() == "mine"


@pytest.mark.slow
def test_info_says_what_the_world_is(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    size = ("--size", "30", "--height", "2", "--option", "max-error=0.1")
    wct("info", "hill.png", *size, "-o", "hill-info.png")
    told = capsys.readouterr().out
    for word in ("30 x", "0.000 to 2.000 m", "drivable, husky", "watertight", "yes"):
        assert word in told, told
    error = float(told.split("mesh error")[1].split("m at")[0].strip(" │\n"))
    assert 0.02 < error <= 0.1
    assert cv2.imread("hill-info.png") is not None
    wct("info", "room.yaml")
    told = capsys.readouterr().out
    assert "11 of 2400 cells of 0.1 m" in told
    assert "exact" in told


def test_info_says_what_a_lidar_has_to_hold_on_to(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wct("info", "hill.png", "--size", "30", "--height", "2", "--robot", "jackal")
    told = " ".join(capsys.readouterr().out.split())
    assert "walls in sight, jackal" in told
    assert "of 1081 beams a scan" in told
    assert "expectation" in told


@pytest.mark.parametrize("source", MESHES)
def test_convert_keeps_shape_and_up(source: str, folder: Path) -> None:
    wedge = trimesh.Trimesh(
        [(0, 0, 0), (4, 0, 0), (4, 2, 0), (0, 2, 0), (0, 0, 1), (0, 2, 1)],
        [(0, 2, 1), (0, 3, 2), (0, 1, 4), (3, 5, 2), (1, 2, 5), (1, 5, 4), (0, 4, 5), (0, 5, 3)],
    )
    assert wedge.is_watertight
    wedge.export("wedge.stl")
    wct("convert", "wedge.stl", f"first{source}")
    for target in MESHES:
        wct("convert", f"first{source}", f"second{target}")
        mesh = read_upright(Path(f"second{target}"))
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(4.0, rel=1e-5)
        np.testing.assert_allclose(mesh.bounds, [(0, 0, 0), (4, 2, 1)], atol=1e-5)
        assert not np.isin(mesh.vertices[:, 2], (0.0,)).all()
    wct("convert", "wedge.stl", "turned.stl", "--rotate-x", "90")
    np.testing.assert_allclose(read_upright(Path("turned.stl")).bounds, [(0, -1, 0), (4, 0, 2)], atol=1e-6)


@pytest.mark.parametrize(
    "source", ["hill.png", "room.yaml", pytest.param("ball.ply", marks=pytest.mark.slow)]
)
def test_an_mjcf_of_every_kind_of_source_compiles(source: str, folder: Path) -> None:
    trimesh.creation.icosphere(1, 3.0).export("ball.ply")
    built(source, to="mjcf")
    model = mujoco.MjModel.from_xml_path("out/w/w.xml")
    mujoco.mj_step(model, mujoco.MjData(model))
    assert math.isfinite(model.stat.extent)


def test_without_a_budget_mesh_files_are_within_a_thousandth_of_the_relief(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    z = cv2.resize(cv2.imread("hill.png", cv2.IMREAD_UNCHANGED), (256, 192), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite("fine.png", z)
    world = built("fine.png", "--height", "4", to="stl")
    said = capsys.readouterr().out
    full = 2 * 191 * 255
    assert len(world.mesh.faces) > full
    assert len(world.file_mesh.faces) < full
    assert f"{len(world.file_mesh.faces)} triangles within 4 mm of the height field everywhere" in said
    assert "--max-error 0 keeps all" in said
    written = read_upright(Path("out/w/meshes/w.stl"))
    assert len(written.faces) == len(world.file_mesh.faces)
    assert 0 < mesh_error(world, written) <= 0.004 + 1e-6
    assert mesh_error(world) < 1e-6

    exact = built("fine.png", "--height", "4", "--max-error", "0", to="stl")
    assert "keeps all" not in capsys.readouterr().out
    assert len(read_upright(Path("out/w/meshes/w.stl")).faces) == len(exact.mesh.faces) > full


@pytest.mark.parametrize("rows", [2, STRIP, STRIP + 1, 2 * STRIP + 3])
def test_strips_are_the_whole(rows: int) -> None:
    z = np.random.default_rng(rows).random((rows, 5)).astype(np.float32)
    surface = HeightField.centered(z, (0.5, 0.2))
    np.testing.assert_allclose(_slopes(surface), np.degrees(surface.slope()), rtol=1e-6)
