"""A world's two files: every field comes back, and what is damaged is named."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_wct.errors import SourceError
from lirs_wct.formats.world_json import WorldFile, checked_content, read_world, write_world
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.walls import WallGrid

RNG = np.random.default_rng(4)
SURFACE = HeightField(RNG.normal(size=(3, 4)).astype(np.float32), (0.5, 0.25), (-7.0, 3.0))
SOLID = np.array([[True, False, False], [False, False, True]])
HOLE = np.array([[False, True, False], [False, False, False]])
WALLS = WallGrid(SOLID, 0.125, Pose2(1.0, -2.0, 0.5), 1.75, HOLE)
TRUTH = OccupancyGrid(np.float32([[1.5, np.nan], [-2.5, 0.0]]), 0.0625, Pose2(4.0, 5.0, -0.25))
MESH = TriangleMesh(RNG.normal(size=(4, 3)), np.array([[0, 1, 2], [0, 2, 3]], np.int32))
PLAIN: dict[str, Any] = {"name": "a place", "kind": "terrain", "scale": "as given", "surface": SURFACE}


def again(folder: Path, **fields: Any) -> WorldFile:
    assert write_world(WorldFile(**PLAIN | fields), folder) == folder
    return read_world(folder)


def test_what_every_world_has(tmp_path: Path) -> None:
    poses = (Pose2(1.0, 2.0, 3.0), Pose2(-4.0, 5.5, -0.5))
    found = again(tmp_path, spawn_poses=poses)
    assert (found.name, found.kind, found.scale) == ("a place", "terrain", "as given")
    np.testing.assert_array_equal(found.surface.z, SURFACE.z)
    assert (found.surface.cell, found.surface.origin) == (SURFACE.cell, SURFACE.origin)
    assert found.spawn_poses == poses
    assert (found.walls, found.truth, found.solid, found.no_ground) == (None, None, None, None)
    assert found.overhangs is False
    assert found.export_options == {"texture": None}


def test_the_texture_is_kept_beside_the_world(tmp_path: Path) -> None:
    picture = tmp_path / "my grass.PNG"
    picture.write_bytes(b"a picture")
    found = again(tmp_path / "out", export_options={"texture": picture, "max_error": 0.5})
    kept = tmp_path / "out" / "materials" / "textures" / "a place.png"
    assert found.export_options == {"texture": kept, "max_error": 0.5}
    assert kept.read_bytes() == b"a picture"


def test_heights_are_stored_and_the_rest_is_compressed(tmp_path: Path) -> None:
    again(tmp_path, walls=WALLS, truth=TRUTH, solid=MESH)
    with zipfile.ZipFile(tmp_path / "world.npz") as file:
        kinds = {entry.filename: entry.compress_type for entry in file.infolist()}
    assert kinds.pop("surface.npy") == zipfile.ZIP_STORED
    assert set(kinds) == {f"{name}.npy" for name in ("walls", "hole", "truth", "vertices", "faces")}
    assert set(kinds.values()) == {zipfile.ZIP_DEFLATED}


def test_another_schema_is_refused(tmp_path: Path) -> None:
    again(tmp_path)
    entry = json.loads((tmp_path / "world.json").read_text())
    assert entry["schema"] == 1
    entry["schema"] = 2
    (tmp_path / "world.json").write_text(json.dumps(entry))
    with pytest.raises(SourceError, match="schema 2 is not the one this version reads \\(1\\)"):
        read_world(tmp_path)


@pytest.mark.parametrize("cell", [1e-300, 1e300])
def test_a_surface_beyond_all_scales_is_refused(tmp_path: Path, cell: float) -> None:
    again(tmp_path)
    entry = json.loads((tmp_path / "world.json").read_text())
    entry["surface"]["cell"][0] = cell
    (tmp_path / "world.json").write_text(json.dumps(entry))
    with pytest.raises(SourceError, match=r"cell must be 1e-05 to 1e\+06 m, got"):
        read_world(tmp_path)


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
