"""Contact: grids within their budget, shells as thick as the body, bodies come apart."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lirs_wct.contact.parts import FEW_FACES, _thickness, bodies, convex_parts, shell_parts, touching_volume
from lirs_wct.contact.spec import ContactGrid, contact_grid, steep_nodes
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.sources.build import build_world


def deviations(surface: HeightField, grid: ContactGrid) -> tuple[float, float]:
    """Vertical deviation at gentle nodes; at the others the distance at which the height is met.

    By sampling the contact surface with `height_at`, four samples a cell, instead of by windows.
    """
    contact = grid.heights(surface)
    west, south, _, _ = surface.bounds
    rows, cols = surface.shape
    x = west + surface.cell[0] * np.arange(cols)
    y = south + surface.cell[1] * np.arange(rows)
    z = surface.south_up.astype(np.float64)
    w, s, e, n = contact.bounds

    def at(px: float | np.ndarray, py: float | np.ndarray) -> np.ndarray:
        return contact.height_at(np.clip(px, w, e), np.clip(py, s, n))

    vertical = np.abs(at(x[None, :], y[:, None]) - z)
    steep = steep_nodes(surface.south_up, surface.cell, math.radians(45))
    worst = 0.0
    for r, c in np.argwhere((vertical > grid.vertical_budget) & steep):
        for reach in np.arange(0.0, grid.horizontal_budget + 1e-9, surface.cell[0] / 4):
            span = np.linspace(-reach, reach, 9)
            heights = at(x[c] + span[None, :], y[r] + span[:, None])
            if heights.min() - grid.match_budget <= z[r, c] <= heights.max() + grid.match_budget:
                worst = max(worst, reach)
                break
        else:
            worst = math.inf
    return float(vertical[~steep].max(initial=0.0)), worst


def field(z: np.ndarray, cell: float = 0.05) -> HeightField:
    return HeightField.centered(z.astype(np.float32), (cell, cell))


def test_smooth_ground_becomes_coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    axis = np.arange(401) * 0.05
    surface = field(np.sin(axis)[None, :] + np.cos(axis)[:, None])
    grid = contact_grid(surface)
    assert grid.stride >= 4
    assert grid.vertical <= 0.01
    vertical, horizontal = deviations(surface, grid)
    assert vertical == pytest.approx(grid.vertical, abs=1e-5)
    assert horizontal == 0.0
    monkeypatch.setattr("lirs_wct.contact.spec.VERTICAL", 0.05)
    assert contact_grid(surface).stride > grid.stride


def test_a_post_of_one_pixel_forbids_coarsening() -> None:
    z = np.zeros((41, 41))
    z[11, 11] = 1.0
    grid = contact_grid(field(z))
    assert grid.stride == 1
    np.testing.assert_array_equal(grid.heights(field(z)).z, field(z).z)


@given(
    seed=st.integers(0, 10_000),
    rows=st.integers(5, 40),
    cols=st.integers(5, 40),
    roughness=st.sampled_from((0.002, 0.02, 0.5)),
)
def test_any_field_keeps_its_budget(seed: int, rows: int, cols: int, roughness: float) -> None:
    rng = np.random.default_rng(seed)
    z = np.cumsum(rng.normal(0, roughness, (rows, cols)), axis=1)
    z += 1.5 * (np.add.outer(np.arange(rows), np.arange(cols)) > rows)
    surface = field(z)
    grid = contact_grid(surface)
    vertical, horizontal = deviations(surface, grid)
    assert vertical <= grid.vertical_budget + 1e-5
    assert horizontal <= grid.horizontal_budget
    west, south, east, north = grid.heights(surface).bounds
    w, s, e, n = surface.bounds
    assert (west, south) == pytest.approx((w, s))
    assert east >= e - 1e-9
    assert north >= n - 1e-9


@pytest.mark.parametrize(
    "name", ["simple", *(pytest.param(name, marks=pytest.mark.slow) for name in ("medium", "advanced"))]
)
def test_bundled_worlds_take_twice_the_spacing(name: str) -> None:
    grid = contact_grid(build_world(name).surface)
    assert grid.stride == 2
    assert grid.vertical <= 0.001
    assert grid.horizontal <= grid.horizontal_budget
    assert grid.nodes == 1025 * 1025


@pytest.fixture
def overlapping() -> TriangleMesh:
    """A slab with four boxes sunk into it, two of them into each other."""
    slab = trimesh.creation.box((10, 10, 1))
    boxes = [trimesh.creation.box((2, 2, 3)).apply_translation((x, 0, 1)) for x in (-3, -2, 0, 3)]
    whole = trimesh.util.concatenate([slab, *boxes])
    return TriangleMesh(np.asarray(whole.vertices, np.float64), np.asarray(whole.faces, np.int32))


def test_bodies_are_closed_and_together_the_mesh(overlapping: TriangleMesh) -> None:
    pieces = list(bodies(overlapping))
    assert [len(piece.faces) for piece in pieces] == [12] * 5
    assert all(piece.is_watertight for piece in pieces)
    assert sum(piece.volume for piece in pieces) == pytest.approx(overlapping.volume)


def test_overlapping_bodies_come_apart(overlapping: TriangleMesh) -> None:
    """All at once, CoACD crashed or did not come to an end."""
    pytest.importorskip("coacd", reason="coacd, the extra [mesh], is not installed")
    parts = list(convex_parts(overlapping))
    assert len(parts) == 5
    low = np.array([part.min(axis=0) for part in parts])
    assert low[:, 2].min() == pytest.approx(-0.5)
    volumes = sorted(trimesh.convex.convex_hull(part).volume for part in parts)
    np.testing.assert_allclose(volumes, [12, 12, 12, 12, 100], rtol=1e-6)


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
