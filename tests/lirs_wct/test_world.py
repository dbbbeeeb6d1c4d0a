"""A source becomes a world, and a folder gives the same world back."""

import json
import zipfile
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_wct import BuildOptions, World, build_world
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.geometry import HeightField, OccupancyGrid, WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import ExportOptions, Ground, LaserMap, MeshGround, Terrain
from lirs_wct.meshing.solid import solid_mesh


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """A ramp that rises to the north-east, 16 bit, wider than high."""
    z = np.add.outer(np.arange(40)[::-1], np.arange(60)).astype(np.uint16) * 500
    path = tmp_path / "ramp.png"
    cv2.imwrite(str(path), z)
    return path


@pytest.fixture
def floor(tmp_path: Path) -> Path:
    """A room of 6 x 4 m with a wall inside, as map_server has it."""
    pixels = np.full((80, 120), 254, np.uint8)
    pixels[[0, -1], :] = pixels[:, [0, -1]] = 0
    pixels[30:50, 60] = 0
    cv2.imwrite(str(tmp_path / "room.pgm"), pixels)
    path = tmp_path / "room.yaml"
    path.write_text(
        "image: room.pgm\nresolution: 0.05\norigin: [-1.0, -2.0, 0.3]\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\nnegate: 0\n"
    )
    return path


def test_a_map_keeps_its_own_frame(floor: Path) -> None:
    world = build_world(floor, BuildOptions(wall_height=1.5))
    assert world.kind == "map"
    assert world.walls is not None
    assert world.walls.origin == Pose2(-1.0, -2.0, 0.3)
    inner = world.walls.origin.apply((60.5 * 0.05, 40 * 0.05))
    assert world.truth is not None
    row, col = world.truth.cells(inner)
    assert world.walls.solid[row, col]
    assert world.walls.height == 1.5
    assert all(world.surface.contains(*corner) for corner in world.walls.corners * 0.999)


def test_every_kind_of_ground_reads_back(tmp_path: Path) -> None:
    """Keys and arrays of `world.json` are what folders in use hold."""
    surface = HeightField.centered(np.eye(3, dtype=np.float32), (0.5, 0.5))
    solid, gaps = solid_mesh(surface), np.eye(3, dtype=np.bool_)
    walls = WallGrid(gaps, 0.1, Pose2(1.0, 2.0, 0.5), 1.5, ~gaps & gaps[0])
    truth = OccupancyGrid.from_probability(np.where(gaps, 0.9, 0.1), 0.1, Pose2(1.0, 2.0, 0.5))
    grounds: tuple[tuple[Ground, set[str], set[str]], ...] = (
        (Terrain(surface), set(), {"surface"}),
        (Terrain(surface, gaps), set(), {"surface", "bare"}),
        (LaserMap(surface, walls, truth), {"walls", "truth"}, {"surface", "walls", "hole", "truth"}),
        (MeshGround(surface, solid), {"overhangs"}, {"surface", "vertices", "faces"}),
        (MeshGround(surface, solid, True, gaps), {"overhangs"}, {"bare", "surface", "vertices", "faces"}),
    )
    common = {"schema", "name", "kind", "scale", "surface", "arrays", "finish", "source"}
    common |= {"starts", "starts_for"}
    for ground, keys, arrays in grounds:
        world = World("w", ground, (Pose2(0.1, 0.2, 0.3),), "as given", ExportOptions(max_error=0.1))
        folder = world.save(tmp_path)
        assert set(json.loads((folder / "world.json").read_text())) == common | keys
        assert set(np.load(folder / "world.npz")) == arrays
        loaded = World.load(folder)
        np.testing.assert_equal(asdict(loaded.ground), asdict(ground))
        assert type(loaded.ground) is type(ground)
        assert (loaded.spawn_poses, loaded.export_options) == (world.spawn_poses, world.export_options)


SURFACE = HeightField(
    np.random.default_rng(4).normal(size=(3, 4)).astype(np.float32), (0.5, 0.25), (-7.0, 3.0)
)
SOLID = np.array([[True, False, False], [False, False, True]])
WALLS = WallGrid(SOLID, 0.125, Pose2(1.0, -2.0, 0.5), 1.75, ~SOLID)


def test_what_every_world_has(tmp_path: Path) -> None:
    poses = (Pose2(1.0, 2.0, 3.0), Pose2(-4.0, 5.5, -0.5))
    world = World("a place", Terrain(SURFACE, None, 2.5), poses, "by hand", start=poses[1], spawn_for="husky")
    assert world.save(tmp_path) == tmp_path
    found = World.load(tmp_path)
    np.testing.assert_array_equal(found.surface.z, SURFACE.z)
    assert (found.surface.cell, found.surface.origin) == (SURFACE.cell, SURFACE.origin)
    assert replace(found, ground=world.ground) == world
    assert found.ground.sample_spacing == 2.5


def test_the_texture_is_kept_beside_the_world(tmp_path: Path) -> None:
    picture = tmp_path / "my grass.PNG"
    picture.write_bytes(b"a picture")
    folder = (
        World("a place", Terrain(SURFACE))
        .with_export(ExportOptions(texture=picture, max_error=0.5))
        .save(tmp_path / "out")
    )
    kept = tmp_path / "out" / "materials" / "textures" / "a place.png"
    assert World.load(folder).export_options == ExportOptions(texture=kept, max_error=0.5)
    assert kept.read_bytes() == b"a picture"


def test_heights_are_stored_and_the_rest_is_compressed(tmp_path: Path) -> None:
    World("a map", LaserMap(SURFACE, WALLS)).save(tmp_path)
    with zipfile.ZipFile(tmp_path / "world.npz") as file:
        kinds = {entry.filename: entry.compress_type for entry in file.infolist()}
    assert kinds.pop("surface.npy") == zipfile.ZIP_STORED
    assert set(kinds) == {f"{name}.npy" for name in ("walls", "hole")}
    assert set(kinds.values()) == {zipfile.ZIP_DEFLATED}


def test_damaged_folders_are_named(picture: Path, tmp_path: Path) -> None:
    folder = build_world(picture).save(tmp_path / "w")
    entry = json.loads((folder / "world.json").read_text())
    for text in (
        "",
        "{",
        "[]",
        "{}",
        json.dumps(entry | {"schema": 99}),
        json.dumps(entry | {"surface": {}}),
        json.dumps(entry | {"surface": entry["surface"] | {"cell": [1e300, 0.25]}}),
        json.dumps(entry | {"finish": {"max_error": -1.0}}),
        json.dumps(entry | {"finish": {"polish": 1}}),
    ):
        (folder / "world.json").write_text(text)
        with pytest.raises(SourceError, match=r"^.*world\.json: "):
            World.load(folder)
    (folder / "world.json").write_text(json.dumps(entry))
    data = (folder / "world.npz").read_bytes()
    (folder / "world.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(SourceError, match="damaged"):
        World.load(folder)


def test_what_is_no_source_is_told_so(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"no such file.*simple, medium, advanced"):
        build_world("smple")
    with pytest.raises(SourceError, match=r"world\.json"):
        build_world(tmp_path)


def test_a_world_too_large_to_search_says_so() -> None:
    """An elevation model of 88 km x 110 km once asked for 3.55 TiB."""
    world = World("dem", Terrain(HeightField.centered(np.zeros((9, 9), np.float32), (11_000.0, 13_800.0))))
    with pytest.raises(SourceError, match=r"cells of 0\.1 m to drive on.*--window"):
        world.traversable(clearance=0.5, max_slope=0.3)


@pytest.mark.parametrize("source", ["simple", "medium"])
@pytest.mark.parametrize(("x", "y"), [(400.0, 0.0), (0.0, -400.0)])
def test_a_start_outside_is_told_how_far_the_world_reaches(source: str, x: float, y: float) -> None:
    west, south, east, north = build_world(source).surface.bounds
    with pytest.raises(ConfigError) as caught:
        build_world(source, BuildOptions(start=Pose2(x, y)))
    said = str(caught.value)
    assert said.startswith(f"{source}: no robot can start at {x:g},{y:g}: that is outside the world")
    assert f"x is {west:.5g} to {east:.5g} m and y {south:.5g} to {north:.5g} m" in said
