"""Thin parts of a body's surface: its triangles outside, nothing beyond it, no gap between."""

import numpy as np
import pytest
import trimesh

from lirs_wct.contact.parts import FEW_FACES, _thickness, convex_parts, shell_parts, touching_volume
from lirs_wct.geometry.mesh import TriangleMesh


def ours(mesh: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))


@pytest.fixture(scope="module")
def ring() -> trimesh.Trimesh:
    """A bumpy torus of 1,008 faces."""
    mesh = trimesh.creation.torus(3.0, 0.8, major_sections=28, minor_sections=18)
    x, y, z = mesh.vertices.T
    bumps = 1 + 0.06 * np.sin(3 * x) * np.cos(4 * y) + 0.05 * np.sin(5 * z + x)
    return trimesh.Trimesh(mesh.vertices * bumps[:, None], mesh.faces, process=False)


def test_each_part_has_its_triangle_outside_and_is_thin(ring: trimesh.Trimesh) -> None:
    body = ours(ring)
    parts = np.array(list(shell_parts(body)))
    np.testing.assert_array_equal(parts[:, :3], body.vertices[body.faces])
    deepest = np.einsum("nki,ni->nk", parts[:, 3:] - parts[:, :1], body.face_normals)
    assert (deepest < 0).all()
    assert deepest.min() > -0.1 - 1e-9
    assert touching_volume(body, parts[:, 3:].reshape(-1, 3)).all()


def test_no_point_just_below_the_surface_is_outside_all_parts(ring: trimesh.Trimesh) -> None:
    body = ours(ring)
    parts = list(shell_parts(body))
    points, face = trimesh.sample.sample_surface(ring, 150, seed=1)
    below = points - 0.01 * body.face_normals[face]
    held = np.zeros(len(below), np.bool_)
    middle = np.array([part.mean(axis=0) for part in parts])
    for n, point in enumerate(below):
        for k in np.argsort(np.linalg.norm(middle - point, axis=1))[:40]:
            hull = trimesh.convex.convex_hull(parts[k])
            signs = ((point - hull.triangles[:, 0]) * hull.face_normals).sum(axis=1)
            if (signs < 1e-9).all():
                held[n] = True
                break
    assert held.all()


def test_a_thin_board_is_halved_not_pierced() -> None:
    board = ours(trimesh.creation.box((2.0, 2.0, 0.02)).subdivide().subdivide())
    parts = np.array(list(shell_parts(board)))
    assert np.abs(parts[..., 2]).max() == pytest.approx(0.01)
    top = parts[(parts[:, :3, 2] > 0.0099).all(axis=1)]
    assert (top[..., 2] >= 0.0).all()


def test_the_way_to_the_next_face_is_that_of_trimeshs_rays(ring: trimesh.Trimesh) -> None:
    normals = np.ascontiguousarray(ring.vertex_normals)
    mine = _thickness(np.asarray(ring.vertices), np.asarray(ring.faces, np.int32), normals, 1e-6)
    some = np.arange(0, len(normals), 13)
    origins = ring.vertices[some] - 1e-4 * normals[some]
    hits, ray, _ = trimesh.ray.ray_triangle.RayMeshIntersector(ring).intersects_location(
        origins, -normals[some], multiple_hits=False
    )
    distance = np.linalg.norm(hits - ring.vertices[some][ray], axis=1)
    np.testing.assert_allclose(mine[some][ray], distance, atol=1e-6)


def test_inside_is_what_trimesh_says_and_overlaps_count_once(ring: trimesh.Trimesh) -> None:
    points = np.random.default_rng(2).uniform(*ring.bounds, (2000, 3))
    np.testing.assert_array_equal(touching_volume(ours(ring), points), ring.contains(points))
    boxes = [trimesh.creation.box((2, 2, 2)).apply_translation((x, 0, 0)) for x in (0, 1)]
    both = ours(trimesh.util.concatenate(boxes))
    tried = np.array([(0.51, 0.1, 0.2), (-0.9, 0.1, 0.2), (1.9, 0.3, 0.2), (2.1, 0, 0)])
    inside = touching_volume(both, tried)
    assert inside.tolist() == [True, True, True, False]


def test_bodies_that_are_convex_stay_whole_and_large_ones_need_no_decomposition(
    ring: trimesh.Trimesh,
) -> None:
    assert len(ring.faces) > FEW_FACES
    far = trimesh.creation.icosphere(subdivisions=2).apply_translation((9, 0, 0))
    parts = list(convex_parts(ours(trimesh.util.concatenate([ring, far]))))
    assert sorted({len(part) for part in parts}) == [6, len(far.vertices)]
    assert len(parts) == len(ring.faces) + 1
