""""""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from lirs_wct.errors import SourceError
from lirs_wct.formats.meshes import writers
from lirs_wct.formats.meshes.reader import read_mesh
from lirs_wct.formats.meshes.writers import write_stl
from tests.kit import hills, refused


def test_read_by_trimesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writers, "_ROWS", 1000)
    mesh = hills()
    write_stl(tmp_path / "a.stl", mesh)
    again = trimesh.load_mesh(tmp_path / "a.stl")
    assert again.is_watertight
    assert len(again.faces) == len(mesh.faces)
    assert again.volume == pytest.approx(mesh.volume, rel=1e-6)
    np.testing.assert_allclose(again.triangles, mesh.vertices[mesh.faces], atol=1e-6)
    np.testing.assert_allclose(again.face_normals, mesh.face_normals, atol=1e-4)
    assert (tmp_path / "a.stl").stat().st_size == 84 + 50 * len(mesh.faces)


def test_unusable_meshes_are_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.stl").write_bytes(b"nonsense")
    (tmp_path / "empty.stl").write_bytes(bytes(84))
    (tmp_path / "a.xyzzy").write_bytes(b"nonsense")
    for name in ("no.stl", "bad.stl", "empty.stl", "a.xyzzy"):
        with refused(f"{tmp_path / name}: "):
            read_mesh(tmp_path / name)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["mujoco__pyramid.stl", "unitree_mujoco__terrain.STL"])
def test_real_files(shared_data: Path, name: str) -> None:
    path = shared_data / "stl" / name
    assert len(read_mesh(path).faces) == (path.stat().st_size - 84) // 50


def cube() -> trimesh.Trimesh:
    return trimesh.creation.box((2, 3, 1))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("solid", "SOLID"),
        ("endsolid", "endsolid box\nsolid second\nendsolid second"),
        ("solid ", "solid vertex_of_a_normal vertex mesh "),
        ("solid \n", "\ufeffsolid \n"),
        ("endsolid", "end solid"),
        ("\n", "\r"),
        ("\n", " "),
        ("vertex", "\tVERTEX"),
        ("endfacet", "endfacet\nendsolid\nsolid next"),
    ],
)
def test_text_however_it_is_written(tmp_path: Path, old: str, new: str) -> None:
    text = str(trimesh.exchange.stl.export_stl_ascii(cube()))
    assert old in text
    (tmp_path / "a.stl").write_text(text.replace(old, new), newline="", encoding="utf-8")
    mesh = read_mesh(tmp_path / "a.stl")
    assert len(mesh.faces) == 12
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0), (2, 3, 1))


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.77, 0.99])
def test_text_that_is_cut_off(tmp_path: Path, share: float) -> None:
    text = str(trimesh.exchange.stl.export_stl_ascii(cube()))
    for end in (int(share * len(text)), text.index("endfacet", int(share * len(text) - 20)) + 8):
        (tmp_path / "a.stl").write_text(text[:end])
        with pytest.raises(SourceError, match=r"a\.stl: .* is cut off or damaged: \d+ corners, \d+ facets"):
            read_mesh(tmp_path / "a.stl")


@pytest.mark.parametrize(
    "header", [bytes(80), b"solid made by a program".ljust(80), b"solid".ljust(80, b"\0")]
)
@pytest.mark.parametrize("behind", [b"", b"\0", b"PROPERTIES".ljust(64)])
def test_bytes_behind_the_triangles(tmp_path: Path, header: bytes, behind: bytes) -> None:
    (tmp_path / "a.stl").write_bytes(header + cube().export(file_type="stl")[80:] + behind)
    assert len(read_mesh(tmp_path / "a.stl").faces) == 12


@pytest.mark.parametrize("header", [bytes(80), b"solid made by a program".ljust(80)])
def test_a_binary_file_that_is_cut_off(tmp_path: Path, header: bytes) -> None:
    (tmp_path / "a.stl").write_bytes(header + cube().export(file_type="stl")[80:-60])
    with pytest.raises(SourceError, match="is cut off: 12 triangles need 684 bytes, it has 624"):
        read_mesh(tmp_path / "a.stl")
