"""A world's two files: every field comes back, and what is damaged is named."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.geometry import HeightField, OccupancyGrid, WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import ExportOptions, LaserMap, Terrain
from lirs_wct.world import World, checked_content

Z = np.random.default_rng(4).normal(size=(3, 4)).astype(np.float32)
SURFACE = HeightField(Z, (0.5, 0.25), (-7.0, 3.0))
SOLID = np.array([[True, False, False], [False, False, True]])
WALLS = WallGrid(SOLID, 0.125, Pose2(1.0, -2.0, 0.5), 1.75, ~SOLID)
TRUTH = OccupancyGrid(np.float32([[1.5, np.nan], [-2.5, 0.0]]), 0.0625, Pose2(4.0, 5.0, -0.25))
HILL = World("a place", Terrain(SURFACE))


def change(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    entry = json.loads((folder / "world.json").read_text())
    change(entry)
    (folder / "world.json").write_text(json.dumps(entry))


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
    folder = HILL.with_export(ExportOptions(texture=picture, max_error=0.5)).save(tmp_path / "out")
    kept = tmp_path / "out" / "materials" / "textures" / "a place.png"
    assert World.load(folder).export_options == ExportOptions(texture=kept, max_error=0.5)
    assert kept.read_bytes() == b"a picture"


def test_heights_are_stored_and_the_rest_is_compressed(tmp_path: Path) -> None:
    World("a map", LaserMap(SURFACE, WALLS, TRUTH)).save(tmp_path)
    with zipfile.ZipFile(tmp_path / "world.npz") as file:
        kinds = {entry.filename: entry.compress_type for entry in file.infolist()}
    assert kinds.pop("surface.npy") == zipfile.ZIP_STORED
    assert set(kinds) == {f"{name}.npy" for name in ("walls", "hole", "truth")}
    assert set(kinds.values()) == {zipfile.ZIP_DEFLATED}


def test_another_schema_is_refused(tmp_path: Path) -> None:
    HILL.save(tmp_path)
    change(tmp_path, lambda entry: entry.update(schema=entry["schema"] + 1))
    with pytest.raises(SourceError, match="schema 2, this version reads 1"):
        World.load(tmp_path)


@pytest.mark.parametrize("cell", [1e-300, 1e300])
def test_a_surface_beyond_all_scales_is_refused(tmp_path: Path, cell: float) -> None:
    HILL.save(tmp_path)
    change(tmp_path, lambda entry: entry["surface"].update(cell=[cell, 0.25]))
    with pytest.raises(SourceError, match=r"cell must be 1e-05 to 1e\+06 m, got"):
        World.load(tmp_path)


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (FileNotFoundError(2, "No such file"), "cannot be read: No such file"),
        (OSError("no number"), "no number"),
        (KeyError("walls"), "'walls' is missing"),
        (ValueError("bad"), "bad"),
    ],
)
def test_damage_is_named(tmp_path: Path, error: Exception, reason: str) -> None:
    with (
        pytest.raises(SourceError, match=rf"world\.json: not a built world, or damaged: {reason}$"),
        checked_content(tmp_path),
    ):
        raise error
