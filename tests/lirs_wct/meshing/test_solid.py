"""The solid is closed, faces outward, and its top is the height field."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.meshing.solid import base_height, solid_mesh, solid_triangles


def hills(rows: int, cols: int, seed: int = 0) -> HeightField:
    z = np.random.default_rng(seed).random((rows, cols)).astype(np.float32) * 3
    return HeightField.centered(z - z.min(), (0.5, 0.25))


@given(st.integers(2, 12), st.integers(2, 12), st.integers(0, 99))
def test_closed_and_outward(rows: int, cols: int, seed: int) -> None:
    surface = hills(rows, cols, seed)
    mesh = solid_mesh(surface)
    assert mesh.is_watertight
    again = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert again.is_watertight
    assert again.is_winding_consistent
    assert again.is_volume
    assert len(mesh.faces) == 2 * (rows - 1) * (cols - 1) + 3 * 2 * (rows + cols - 2)


def test_volume_is_the_integral_of_the_heights() -> None:
    surface = hills(40, 30)
    z = surface.z.astype(float)
    # Each triangle of the split sw-ne has a third of its corners' sum as mean height.
    nw, ne, sw, se = z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]
    triangle = 0.5 * 0.25 / 2
    above = ((nw + sw + ne) / 3 + (sw + se + ne) / 3).sum() * triangle
    below = surface.size[0] * surface.size[1] * -base_height(surface)
    assert solid_mesh(surface).volume == pytest.approx(above + below, rel=1e-12)


def test_upright_and_where_the_field_is() -> None:
    surface = hills(7, 9)
    mesh = solid_mesh(surface)
    w, s, e, n = surface.bounds
    np.testing.assert_array_equal(mesh.bounds[:, :2], [[w, s], [e, n]])
    assert mesh.bounds[1, 2] == surface.z.max()
    assert mesh.bounds[0, 2] == pytest.approx(-surface.relief / 10)
    top = mesh.vertices[: surface.z.size]
    np.testing.assert_allclose(surface.height_at(top[:, 0], top[:, 1]), top[:, 2], atol=1e-5)


def test_the_top_is_the_field_between_its_nodes_too() -> None:
    surface = hills(12, 15)
    mesh = solid_mesh(surface)
    rng = np.random.default_rng(1)
    w, s, e, n = surface.bounds
    xy = rng.uniform((w, s), (e, n), (300, 2))
    origins = np.column_stack((xy, np.full(300, 99.0)))
    down = np.tile([0.0, 0.0, -1.0], (300, 1))
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    hits, rays, _ = solid.ray.intersects_location(origins, down, multiple_hits=False)
    assert len(rays) == 300
    np.testing.assert_allclose(surface.height_at(*xy[rays].T), hits[:, 2], atol=1e-6)


def test_flat_ground_still_has_a_body() -> None:
    mesh = solid_mesh(HeightField.centered(np.zeros((2, 2), np.float32), (1, 1)))
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.1)


def test_triangles_row_by_row_are_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lirs_wct.meshing.solid._BLOCK", 50)
    surface = hills(23, 17)
    mesh = solid_mesh(surface)
    count, chunks = solid_triangles(surface)
    triangles = list(chunks)
    assert len(triangles) > 5
    together = np.concatenate(triangles)
    assert count == len(together) == len(mesh.faces)
    np.testing.assert_array_equal(together, mesh.vertices[mesh.faces])
