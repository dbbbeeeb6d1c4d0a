"""Triangle meshes: closed bodies, normals, turns, and tiles without cracks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lirs_wct.errors import ConfigError
from lirs_wct.export.appearance import cube_uv
from lirs_wct.formats.meshes.writers import write_stl
from lirs_wct.geometry.mesh import TriangleMesh, split_tiles
from tests.kit import hills

POINTS = np.random.default_rng(7).normal(size=(4, 3))
ONE = np.array([[0, 1, 2]], np.int32)


def solid(seed: int) -> TriangleMesh:
    """A closed body somewhere: the hull of points."""
    rng = np.random.default_rng(seed)
    hull = trimesh.Trimesh(rng.normal(size=(9, 3)) * (1, 2, 3) + rng.uniform(-9, 9, 3)).convex_hull
    return TriangleMesh(np.array(hull.vertices), np.array(hull.faces, np.int32))


@given(st.integers(0, 99))
def test_closed_bodies_are_as_trimesh_has_them(seed: int) -> None:
    mesh = solid(seed)
    theirs = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(theirs.volume, rel=1e-9)
    np.testing.assert_allclose(mesh.bounds, theirs.bounds)
    np.testing.assert_allclose(mesh.face_normals, theirs.face_normals, atol=1e-9)
    inside_out = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1].copy())
    assert inside_out.is_watertight
    assert inside_out.volume == pytest.approx(-theirs.volume, rel=1e-9)


@given(st.integers(0, 99))
def test_what_is_not_closed(seed: int) -> None:
    mesh = solid(seed)
    turned = mesh.faces.copy()
    turned[seed % len(turned)] = turned[seed % len(turned)][::-1]
    for faces in (mesh.faces[1:], turned, np.concatenate((mesh.faces, mesh.faces[:1]))):
        assert not TriangleMesh(mesh.vertices, faces).is_watertight
    twice = np.concatenate((mesh.faces, mesh.faces[:1], mesh.faces[:1, ::-1]))  # a fin without thickness
    assert not TriangleMesh(mesh.vertices, twice).is_watertight
    assert TriangleMesh(mesh.vertices, mesh.faces[:0]).is_watertight


def test_closed_as_an_stl_is_what_trimesh_says_of_it(tmp_path: Path) -> None:
    """Two tetrahedra that share an edge by position are closed by index, and not in the file."""
    one, moved = solid(3), np.array((1e-3, 0, 0))
    edge = one.vertices[one.faces[0, :2]]
    for shift, closed in ((0.0, False), (1.0, True)):
        other = (
            np.concatenate((edge, edge.mean(axis=0) + one.face_normals[0] * 9 + np.eye(3)[:2]))
            + shift * moved
        )
        faces = np.array(((0, 1, 2), (1, 0, 3), (0, 2, 3), (2, 1, 3)), np.int32) + len(one.vertices)
        both = TriangleMesh(np.concatenate((one.vertices, other)), np.concatenate((one.faces, faces)))
        write_stl(tmp_path / "both.stl", both)
        assert both.is_watertight
        assert both.is_watertight_as_written == closed
        assert trimesh.load_mesh(tmp_path / "both.stl").is_watertight == closed


def test_a_triangle_without_area_has_no_normal() -> None:
    faces = np.array([[0, 1, 1], [0, 1, 2]], np.int32)
    normals = TriangleMesh(POINTS, faces).face_normals
    assert normals[0].tolist() == [0, 0, 0]
    assert np.linalg.norm(normals[1]) == pytest.approx(1.0)


@pytest.mark.parametrize("degrees", [90.0, -30.0])
def test_turned_about_x(degrees: float) -> None:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn = np.array(((1, 0, 0), (0, c, -s), (0, s, c)))
    mesh = TriangleMesh(POINTS, ONE, normals=POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True))
    found = mesh.rotated_x(degrees)
    np.testing.assert_allclose(found.vertices, POINTS @ turn.T, atol=1e-12)
    assert mesh.normals is not None
    np.testing.assert_allclose(found.normals, mesh.normals @ turn.T, atol=1e-12)
    assert TriangleMesh(POINTS, ONE).rotated_x(degrees).normals is None


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("vertices", POINTS[:, :2]),
        ("faces", np.zeros((2, 4), np.int32)),
        ("faces", np.zeros(3, np.int32)),
        ("uv", np.zeros((3, 2))),
        ("uv", np.zeros((4, 3))),
        ("normals", np.zeros((3, 3))),
        ("normals", np.zeros((4, 2))),
    ],
)
def test_arrays_of_the_wrong_shape_are_named(field: str, values: np.ndarray) -> None:
    whole: dict[str, Any] = {"vertices": POINTS, "faces": ONE, field: values}
    with pytest.raises(ConfigError, match=f"mesh of 4 vertices has arrays of the wrong shape: {field}"):
        TriangleMesh(**whole)
    TriangleMesh(POINTS, ONE, uv=np.zeros((4, 2)), normals=np.zeros((4, 3)))


def test_tiles_are_the_mesh() -> None:
    mesh = hills()
    tiles = list(split_tiles(mesh, aim=400))
    assert len(tiles) > 8
    together = np.concatenate([t.vertices[t.faces] for t in tiles])
    order = np.lexsort(together.reshape(-1, 9).T)
    corners = mesh.vertices[mesh.faces]
    np.testing.assert_array_equal(together[order], corners[np.lexsort(corners.reshape(-1, 9).T)])
    joined = trimesh.util.concatenate([trimesh.Trimesh(t.vertices, t.faces) for t in tiles])
    joined.merge_vertices()
    assert joined.is_watertight


def test_tiles_hold_no_vertex_twice_or_in_vain() -> None:
    for tile in split_tiles(hills(), aim=400):
        assert set(tile.faces.ravel()) == set(range(len(tile.vertices)))
        assert len(np.unique(tile.vertices, axis=0)) == len(tile.vertices)
        assert len(tile.faces) < 1200


def test_never_more_than_the_cap() -> None:
    sizes = [len(t.faces) for t in split_tiles(hills(), aim=10**9, most=1000)]
    assert max(sizes) == 1000
    assert sum(sizes) == len(hills().faces)


def test_attributes_go_along() -> None:
    mesh = cube_uv(hills())
    assert mesh.uv is not None
    assert mesh.normals is not None
    kept = np.concatenate((mesh.vertices, mesh.uv, mesh.normals), axis=1)
    seen = []
    for tile in split_tiles(mesh, aim=400):
        assert tile.normals is not None
        assert tile.uv is not None
        seen.append(np.concatenate((tile.vertices, tile.uv, tile.normals), axis=1)[tile.faces])
    together, whole = np.concatenate(seen).reshape(-1, 24), kept[mesh.faces].reshape(-1, 24)
    np.testing.assert_array_equal(together[np.lexsort(together.T)], whole[np.lexsort(whole.T)])
