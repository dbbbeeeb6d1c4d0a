"""OBJ: each corner names what the mesh has, and no more."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.formats.meshes.writers import write_obj
from lirs_wct.geometry.mesh import TriangleMesh

FACES = np.array(((0, 1, 2), (0, 2, 3)), np.int32)
CORNERS = np.array(((0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.5)))
UV, NORMALS = CORNERS[:, :2].copy(), np.tile((0.0, 0.0, 1.0), (4, 1))


def faces_of(path: Path) -> list[str]:
    return [line[2:] for line in path.read_text().splitlines() if line.startswith("f ")]


@pytest.mark.parametrize(
    ("uv", "normals", "corner"),
    [(None, None, "{0}"), (UV, None, "{0}/{0}"), (None, NORMALS, "{0}//{0}"), (UV, NORMALS, "{0}/{0}/{0}")],
)
def test_a_corner_names_position_texture_and_normal(
    tmp_path: Path, uv: np.ndarray | None, normals: np.ndarray | None, corner: str
) -> None:
    mesh = TriangleMesh(CORNERS, FACES, uv, normals)
    write_obj(tmp_path / "a.obj", [("a", mesh, None)])
    assert faces_of(tmp_path / "a.obj") == [" ".join(corner.format(v + 1) for v in face) for face in FACES]


def test_a_second_part_counts_on(tmp_path: Path) -> None:
    mesh = replace(TriangleMesh(CORNERS, FACES), uv=UV)
    write_obj(tmp_path / "a.obj", [("a", mesh, None), ("b", mesh, None)])
    assert faces_of(tmp_path / "a.obj")[2:] == ["5/5 6/6 7/7", "5/5 7/7 8/8"]
