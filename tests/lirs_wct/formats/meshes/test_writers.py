"""Writers of meshes: usual and brief COLLADA, whole and in pieces; corners of an OBJ."""

import re
from dataclasses import replace
from pathlib import Path

import collada
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from lirs_wct.errors import ConfigError
from lirs_wct.export.appearance import cube_uv
from lirs_wct.export.mesh_writer import write_mesh
from lirs_wct.formats.meshes.writers import MeshPart, write_obj, write_parts
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.solid import solid_mesh
from tests.kit import hills

CLOSE = 6e-3
"""What an attribute may be off: a brief file has two decimals of a normal."""


def triangles_of(shape: collada.geometry.Geometry) -> list[collada.triangleset.TriangleSet]:
    """Triangles of each part, quads cut as every reader does: in a fan from the first corner."""
    sets = shape.primitives
    return [one.triangleset() if isinstance(one, collada.polylist.Polylist) else one for one in sets]


def corners_of(triangles: collada.triangleset.TriangleSet) -> np.ndarray:
    """(m, 3, 8) position, normal and texture coordinates of each corner."""
    uv = triangles.texcoordset[0][triangles.texcoord_indexset[0]]
    position, normal = triangles.vertex[triangles.vertex_index], triangles.normal[triangles.normal_index]
    return np.concatenate((position, normal, uv), axis=2)


@pytest.fixture(params=["usual", "in pieces", "brief"], autouse=True)
def writer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "in pieces":
        monkeypatch.setattr("lirs_wct.formats.meshes.writers._ROWS", 600)
    if request.param == "brief":
        monkeypatch.setattr("lirs_wct.formats.meshes.writers.BULK", 0)
    return str(request.param)


def test_closed_and_unmoved(tmp_path: Path) -> None:
    mesh = hills()
    write_mesh(tmp_path / "a.dae", mesh)
    again = trimesh.load(tmp_path / "a.dae", force="mesh")
    assert len(again.faces) == len(mesh.faces)
    joined = trimesh.Trimesh(again.vertices, again.faces)
    joined.merge_vertices(merge_tex=True, merge_norm=True)
    assert joined.is_watertight
    assert joined.volume == pytest.approx(mesh.volume, rel=1e-5)
    np.testing.assert_allclose(again.bounds, mesh.bounds, atol=1e-4)


def test_axis_unit_material_and_inputs(tmp_path: Path) -> None:
    write_parts(tmp_path / "a.dae", [MeshPart("ground", cube_uv(hills()), "../materials/textures/a.png")])
    document = collada.Collada(str(tmp_path / "a.dae"), ignore=[collada.common.DaeUnsupportedError])
    assert document.errors == []
    assert document.assetInfo.upaxis == "Z_UP"
    assert document.assetInfo.unitmeter == 1.0
    assert [image.path for image in document.images] == ["../materials/textures/a.png"]
    assert isinstance(document.effects[0].diffuse, collada.material.Map)
    for shape in document.geometries:
        (triangles,) = shape.primitives
        kinds = ("VERTEX", "NORMAL", "TEXCOORD")
        offsets = [entry[0] for kind in kinds for entry in triangles.sources[kind]]
        assert sorted(offsets) == [0, 1, 2]
        bound = list(document.scene.objects("geometry"))
        assert len(bound) == len(document.geometries)


def test_parts_of_two_materials_are_one_object_with_one_layer(tmp_path: Path) -> None:
    """Blender names a layer after the source's id, and joins objects without those of another name."""
    low, high = cube_uv(hills()), cube_uv(hills(5, 6))
    parts = [MeshPart("ground", low, "ground.png"), MeshPart("walls", high, "walls.png")]
    write_parts(tmp_path / "a.dae", parts)
    document = collada.Collada(str(tmp_path / "a.dae"), ignore=[collada.common.DaeUnsupportedError])
    assert document.errors == []
    (shape,) = document.geometries
    assert {triangles.sources["TEXCOORD"][0][2] for triangles in shape.primitives} == {"#UV"}
    pictures = {}
    for bound in next(document.scene.objects("geometry")).primitives():
        triangles = bound.triangleset() if isinstance(bound, collada.polylist.BoundPolylist) else bound
        pictures[bound.material.effect.diffuse.sampler.surface.image.path] = len(triangles)
    assert pictures == {"ground.png": len(low.faces), "walls.png": len(high.faces)}
    # Gazebo looks a sampler up in the whole document.
    samplers = re.findall(r'newparam sid="(\w+)"', (tmp_path / "a.dae").read_text())
    assert len(samplers) == len(set(samplers)) == 4
    for triangles, part in zip(triangles_of(shape), parts, strict=True):
        check_corners(corners_of(triangles), part.mesh)


def test_attributes_belong_to_their_corners(tmp_path: Path) -> None:
    mesh = cube_uv(hills())
    write_mesh(tmp_path / "a.dae", mesh)
    document = collada.Collada(str(tmp_path / "a.dae"))
    (shape,) = document.geometries
    check_corners(corners_of(triangles_of(shape)[0]), mesh)


def check_corners(found: np.ndarray, mesh: TriangleMesh) -> None:
    """The same triangles, each with its corners in the same turn; which comes first does not matter."""
    expected = np.concatenate((mesh.vertices, mesh.normals, mesh.uv), axis=1)[mesh.faces]
    turned = np.concatenate([np.roll(expected, k, axis=1) for k in range(3)])
    _, where = cKDTree(turned[:, :, :3].reshape(-1, 9)).query(found[:, :, :3].reshape(-1, 9))
    assert len(set(where % len(expected))) == len(expected) == len(found)
    np.testing.assert_allclose(found, turned[where], atol=CLOSE)
    plain = [0, 1, 2, 6, 7]
    np.testing.assert_allclose(found[:, :, plain], turned[where][:, :, plain], atol=6e-4)


def test_bytes_count_in_large_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Indices are most of a file: a grid's cells are quads, and equal normals one."""
    rows, cols = np.mgrid[:90, :120]
    smooth = solid_mesh(
        HeightField.centered((np.sin(rows / 9) + np.cos(cols / 9)).astype(np.float32), (1, 1))
    )
    monkeypatch.setattr("lirs_wct.formats.meshes.writers.BULK", len(smooth.faces))
    write_mesh(tmp_path / "a.dae", smooth)
    monkeypatch.setattr("lirs_wct.formats.meshes.writers.BULK", 0)
    write_mesh(tmp_path / "b.dae", smooth)
    (shape,) = collada.Collada(str(tmp_path / "b.dae")).geometries
    (polygons,) = shape.primitives
    assert (polygons.vcounts == 4).sum() == 89 * 119
    assert len(np.unique(polygons.normal, axis=0)) == len(polygons.normal)
    assert (tmp_path / "b.dae").stat().st_size < 0.75 * (tmp_path / "a.dae").stat().st_size


def test_positions_are_exact_as_float32(tmp_path: Path) -> None:
    """On rough ground a tenth of a millimeter sideways is many times that in height."""
    z = np.random.default_rng(2).random((40, 50)).astype(np.float32)
    for scale in (0.001, 1.0, 3000.0):
        mesh = solid_mesh(HeightField.centered(np.float32(scale) * z, (0.7 * scale, 0.3 * scale)))
        write_mesh(tmp_path / "a.dae", mesh)
        (shape,) = collada.Collada(str(tmp_path / "a.dae")).geometries
        step = np.spacing(np.abs(mesh.bounds).max(axis=0).astype(np.float32))
        apart, _ = cKDTree(mesh.vertices / step).query(shape.primitives[0].vertex / step, p=np.inf)
        assert apart.max() < 1.01


def test_spaces_in_a_texture_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="must not hold spaces"):
        write_parts(tmp_path / "a.dae", [MeshPart("ground", cube_uv(hills()), "../my texture.png")])
    assert list(tmp_path.iterdir()) == []


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
