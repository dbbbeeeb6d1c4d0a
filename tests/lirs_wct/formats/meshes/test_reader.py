"""Meshes are read upright, in meters, with one vertex a place, as Assimp reads other programs' files."""

import re
import shutil
import struct
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lirs_wct.errors import SourceError
from lirs_wct.formats import MESHES
from lirs_wct.formats.meshes.reader import read_mesh, read_upright
from lirs_wct.formats.meshes.writers import fixed_text
from lirs_wct.geometry.mesh import TriangleMesh

CORNERS = np.array([(1.0, 2.0, 3.0), (5.0, 2.0, 3.5), (1.0, 7.0, 4.0)])


def stl(path: Path, triangles: np.ndarray) -> Path:
    """Write binary STL by hand."""
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in np.asarray(triangles))
    path.write_bytes(bytes(80) + struct.pack("<I", len(triangles)) + body)
    return path


def dae(path: Path, asset: str, padding: int = 0) -> Path:
    numbers = " ".join(map(str, CORNERS.ravel()))
    path.write_text(
        f'<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<!--{'x' * padding}--><asset>{asset}</asset>"
        f'<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="9">{numbers}'
        '</float_array><technique_common><accessor source="#a" count="3" stride="3">'
        '<param name="X" type="float"/><param name="Y" type="float"/>'
        '<param name="Z" type="float"/></accessor></technique_common></source>'
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="1">'
        '<input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>'
        '</library_geometries><library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/>'
        "</node></visual_scene></library_visual_scenes>"
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )
    return path


def triangles(mesh: TriangleMesh) -> list[list[list[float]]]:
    """Return the corners of each triangle, the least first."""
    found = []
    for t in mesh.vertices[mesh.faces].round(6).tolist():
        k = t.index(min(t))
        found.append(t[k:] + t[:k])
    return sorted(found)


UP = {
    "Z": CORNERS,
    "Y": np.column_stack((CORNERS[:, 0], -CORNERS[:, 2], CORNERS[:, 1])),  # y up: z points south
    "X": np.column_stack((-CORNERS[:, 1], -CORNERS[:, 2], CORNERS[:, 0])),  # -y to the right, z to the viewer
}


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.0254])
def test_collada_says_its_axis_and_its_unit(tmp_path: Path, unit: float) -> None:
    for up, expected in UP.items():
        asset = f'<unit name="u" meter="{unit}"/><up_axis> {up}_UP </up_axis>'
        mesh = read_upright(dae(tmp_path / "a.dae", asset))
        assert triangles(mesh) == triangles(TriangleMesh(expected * unit, np.array([[0, 1, 2]], np.int32)))


def test_collada_without_a_word_has_y_up_in_meters(tmp_path: Path) -> None:
    expected = TriangleMesh(UP["Y"], np.array([[0, 1, 2]], np.int32))
    assert triangles(read_upright(dae(tmp_path / "a.dae", ""))) == triangles(expected)


@pytest.mark.parametrize(
    ("asset", "told"),
    [
        ('<unit meter="inch"/>', "its unit is not a number of meters"),
        ('<unit meter="0"/>', "its unit must be above 0 m, got 0"),
        ('<unit meter="-1"/>', "its unit must be above 0 m, got -1"),
        ('<unit meter="inf"/>', "its unit must be above 0 m, got inf"),
    ],
)
def test_a_unit_that_is_none(tmp_path: Path, asset: str, told: str) -> None:
    with pytest.raises(SourceError, match=rf"a\.dae: {told}"):
        read_upright(dae(tmp_path / "a.dae", asset))


def test_the_asset_is_an_element_and_no_text(tmp_path: Path) -> None:
    """The axis was looked for as text in the first 64 KiB: comments and prefixes hid it."""
    expected = triangles(TriangleMesh(UP["Z"] * 0.5, np.array([[0, 1, 2]], np.int32)))
    asset = "<!-- <up_axis>X_UP</up_axis><unit meter='9'/> --><unit meter='.5'/><up_axis>Z_UP</up_axis>"
    path = dae(tmp_path / "a.dae", asset, padding=70_000)
    assert triangles(read_upright(path)) == expected
    text = re.sub(r"<(/?)(?=\w)", r"<\1c:", path.read_text()).replace("xmlns=", "xmlns:c=")
    path.write_text(text)
    assert "<c:up_axis>" in text
    assert triangles(read_upright(path)) == expected
    path.write_text(re.sub(r"c:|xmlns:c=\S+", "", text))
    assert triangles(read_upright(path)) == expected


def test_a_glb_has_y_up_and_the_others_z(tmp_path: Path) -> None:
    whole = trimesh.Trimesh(CORNERS, [[0, 1, 2]], process=False)
    for suffix, up in ((".glb", "Y"), (".ply", "Z"), (".obj", "Z"), (".STL", "Z")):
        path = tmp_path / f"a{suffix}"
        whole.export(path, file_type=suffix[1:].lower())
        assert triangles(read_upright(path)) == triangles(
            TriangleMesh(UP[up], np.array([[0, 1, 2]], np.int32))
        )


@pytest.mark.parametrize("number", ["inf", "-inf", "nan", "1e400", "1e39", "-1e200"])
@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_a_coordinate_that_is_no_place(tmp_path: Path, suffix: str, number: str) -> None:
    """One bad vertex was dropped with its triangles, and a message on a hole or on a cell followed."""
    path, box = tmp_path / f"a{suffix}", trimesh.creation.box((4.0, 4.0, 12345.0))
    kind = {".stl": "stl_ascii"}.get(suffix, suffix[1:])
    box.export(path, file_type=kind, **({"encoding": "ascii"} if suffix == ".ply" else {}))
    assert len(read_upright(path).vertices) == 8
    text = path.read_text()
    assert "6172.5" in text
    path.write_text(re.sub(r"-?6172\.50*", number, text, count=1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        with pytest.raises(SourceError) as refused:
            read_upright(path)
    assert str(refused.value).startswith(
        f"{path}: has vertices that are not finite, or farther than 1e+09 units"
    )


def test_a_suffix_that_is_no_mesh(tmp_path: Path) -> None:
    path = stl(tmp_path / "a.stl", CORNERS[None]).rename(tmp_path / "a.xyz")
    with pytest.raises(SourceError, match=r"a\.xyz: not a mesh that is read; legal: "):
        read_upright(path)


@given(st.integers(0, 2**32 - 1))
def test_one_vertex_a_place_and_no_triangle_without_area(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    places = rng.integers(-2, 3, (6, 3)).astype(np.float32)
    places[rng.random((6, 3)) < 0.2] = -0.0
    faces = rng.integers(0, 6, (9, 3))
    faces[0] = (0, 1, 2)
    places[:3] = ((0, 0, -0.0), (1, 0, 0), (0, 1, 0))
    mesh = read_upright(stl(tmp_path_factory.mktemp("m") / "a.stl", places[faces]))
    corners = [[tuple(p) for p in t] for t in (places[faces] + 0.0).tolist()]
    whole = [t for t in corners if len(set(t)) == 3]
    assert len(mesh.faces) == len(whole)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], np.array(whole))
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    assert mesh.faces.dtype == np.int32


@pytest.mark.parametrize(
    ("number", "decimals", "text"),
    [
        (0, 0, "0"),
        (0, 3, "0"),
        (-0.0001, 3, "0"),
        (0.5, 3, ".5"),
        (-0.25, 3, "-.25"),
        (12.0, 3, "12"),
        (100, 0, "100"),
        (1.0004, 3, "1"),
        (0.0996, 3, ".1"),
        (0.012, 3, ".012"),
        (-24.9512, 4, "-24.9512"),
        (999.9999, 3, "1000"),
    ],
)
def test_numbers(number: float, decimals: int, text: str) -> None:
    assert fixed_text([[number]], decimals) == f"{text}\n".encode()


@given(st.floats(-1e6, 1e6), st.integers(0, 6))
def test_read_back(number: float, decimals: int) -> None:
    assert float(fixed_text([[number]], decimals)) == pytest.approx(number, abs=0.501 * 10**-decimals)


WRONG = {
    "quantn.glb": "does not scale normalized integers",
    "trail.stl": "refuses bytes behind the triangles",
    "window_ph.dae": "refuses holes",
    "draco.glb": "is refused by both",
    "node_missing.dae": "leaves the missing node out",
}
"""Files in which Assimp 5.2 is no oracle, and the reason."""


def by_assimp(path: Path, folder: Path) -> TriangleMesh:
    tool = shutil.which("assimp")
    if tool is None:
        pytest.skip("assimp is not installed")
    out = folder / "out.obj"
    subprocess.run([tool, "export", path, out, "-tri"], check=True, capture_output=True)
    rows = [line.split() for line in out.read_text().splitlines()]
    faces = [[int(corner.split("/")[0]) - 1 for corner in row[1:]] for row in rows if row[:1] == ["f"]]
    places = [row[1:4] for row in rows if row[:1] == ["v"]]
    return TriangleMesh(np.array(places, np.float64), np.array(faces, np.int32))


@pytest.mark.shared
def test_assimp_reads_the_same(shared_data: Path, tmp_path: Path) -> None:
    files = [path for path in sorted(shared_data.rglob("*")) if path.suffix.lower() in MESHES]
    assert files
    for path in files:
        if path.name in WRONG or path.stat().st_size > 5e6:
            continue
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*(left out|plain shape)")
            mesh = read_mesh(path)
        other = by_assimp(path, tmp_path)
        sizes = [sorted(np.ptp(m.vertices[m.faces].reshape(-1, 3), axis=0)) for m in (mesh, other)]
        np.testing.assert_allclose(*sizes, rtol=1e-5, atol=1e-4, err_msg=path.name)
        assert len(mesh.faces) == len(other.faces), path.name
        assert mesh.face_areas.sum() == pytest.approx(other.face_areas.sum(), rel=1e-4), path.name
