"""Closed solids of height fields and of laser maps."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from lirs_wct.formats.meshes.writers import write_stl
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.meshing.solid import base_height, solid_mesh, solid_triangles
from lirs_wct.meshing.walls import SLAB, wall_mesh


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


kinds = hnp.arrays(np.int8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.integers(0, 2))


@given(kinds, st.floats(-3, 3))
def test_holes_go_through_and_leave_the_solid_closed(kind: np.ndarray, yaw: float) -> None:
    if not kind.any():
        return
    walls = WallGrid(kind == 2, 0.5, Pose2(1, 2, yaw), 2.0, kind == 0)
    mesh = wall_mesh(walls)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.25 * ((kind > 0).sum() * SLAB + (kind == 2).sum() * 2.0), rel=0.01)
    assert (np.linalg.norm(mesh.face_normals, axis=1) > 0.5).all()
    below = mesh.face_normals[:, 2] < -0.5
    tops = mesh.vertices[mesh.faces[below]][:, :, 2]
    assert (tops == -SLAB).all()
    level = np.abs(mesh.face_normals[:, 2]) > 0.5
    centers = mesh.vertices[mesh.faces[level]].mean(axis=1)[:, :2]
    col, row = np.floor(walls.origin.inverse().apply(centers) / 0.5).astype(int).T
    assert (kind[row, col] > 0).all()


@given(kinds, st.floats(-3, 3))
def test_every_point_is_inside_where_its_cell_says_so(kind: np.ndarray, yaw: float) -> None:
    """Points in the slab, in the walls and above them, by the winding number of the mesh about each."""
    kind[0, 0] = 1
    walls = WallGrid(kind == 2, 0.5, Pose2(-8, 3, yaw), 2.0, kind == 0)
    mesh = wall_mesh(walls)
    assert mesh.bounds[:, 2].tolist() == [-0.1, 2.0 if (kind == 2).any() else 0.0]
    triangles = mesh.vertices[mesh.faces]
    cells = np.argwhere(kind >= 0)
    plan = walls.origin.apply((cells[:, ::-1] + (0.3, 0.7)) * 0.5)
    for z, least in ((-0.05, 1), (0.4, 2), (1.9, 2), (2.1, 3), (-0.3, 3)):
        points = np.column_stack((plan, np.full(len(plan), z)))
        inside = kind[tuple(cells.T)] >= least
        np.testing.assert_allclose(winding(triangles, points), inside, atol=1e-6)


def winding(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (n,) winding numbers: sums of solid angles (van Oosterom & Strackee 1983) over 4 pi."""
    a, b, c = (triangles[None, :, k] - points[:, None] for k in range(3))
    x, y, z = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    above = np.einsum("nmk,nmk->nm", a, np.cross(b, c))
    below = x * y * z + (a * b).sum(2) * z + (b * c).sum(2) * x + (c * a).sum(2) * y
    return 2 * np.arctan2(above, below).sum(axis=1) / (4 * np.pi)


@given(kinds)
def test_no_edge_joins_more_than_two_triangles(kind: np.ndarray) -> None:
    """trimesh's own test, also where walls or floors touch at a corner only."""
    kind[-1, -1] = 2
    mesh = wall_mesh(WallGrid(kind == 2, 0.5, Pose2(), 2.0, kind == 0))
    theirs = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert theirs.is_watertight
    assert theirs.is_winding_consistent
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)


@pytest.mark.parametrize(("southern", "northern"), [(0, 1), (1, 0)])
@pytest.mark.parametrize("least", [1, 2])
def test_of_two_that_touch_at_a_corner_the_northern_one_ends_inside_its_cell(
    southern: int, northern: int, least: int
) -> None:
    kind = np.full((2, 2), least - 1)
    kind[0, southern] = kind[1, northern] = least
    mesh = wall_mesh(WallGrid(kind == 2, 0.5, Pose2(), 2.0, kind == 0))
    top = mesh.vertices[mesh.vertices[:, 2] == (2.0 if least == 2 else 0.0), :2] - 0.5
    near = sorted(top[np.linalg.norm(top, axis=1) < 0.1].round(6).tolist())
    assert near == sorted([[0.0, 0.0], [0.001 if northern == 1 else -0.001, 0.001]])


@pytest.mark.slow
@given(kinds, st.floats(-3, 3), st.sampled_from((0.5, 0.05, 0.005)))
def test_a_reader_that_merges_equal_positions_has_a_manifold(
    kind: np.ndarray, yaw: float, resolution: float
) -> None:
    """An STL as trimesh reads it: two triangles an edge, one fan of triangles a vertex."""
    kind[-1, -1] = 2
    mesh = wall_mesh(WallGrid(kind == 2, resolution, Pose2(40, -20, yaw), 2.0, kind == 0))
    with tempfile.TemporaryDirectory() as folder:
        write_stl(Path(folder) / "walls.stl", mesh)
        read = trimesh.load_mesh(Path(folder) / "walls.stl")
    assert len(read.vertices) == len(mesh.vertices)
    assert read.is_watertight
    assert read.is_winding_consistent
    assert fans(read) == len(read.vertices)


def fans(mesh: trimesh.Trimesh) -> int:
    """Return the number of fans: triangles around a vertex that hang together by edges at it."""
    corners = np.arange(mesh.faces.size).reshape(-1, 3)
    at = [dict(zip(face, corner, strict=True)) for face, corner in zip(mesh.faces, corners, strict=True)]
    links = [
        (at[one][v], at[other][v])
        for (one, other), edge in zip(mesh.face_adjacency, mesh.face_adjacency_edges, strict=True)
        for v in edge
    ]
    return len(trimesh.graph.connected_components(np.array(links), nodes=corners.ravel(), min_len=1))


@pytest.mark.parametrize(
    ("shape", "wall", "faces"),
    [
        # A block: two triangles a side above and below the floor, two on top, a fan of 4 below.
        ((3, 5), (0, 3, 0, 5), 4 * 2 + 4 * 2 + 2 + 4),
        # Floor alone: a box.
        ((3, 5), (0, 0, 0, 0), 2 + 4 * 2 + 4),
    ],
)
def test_large_cells_are_few_triangles(
    shape: tuple[int, int], wall: tuple[int, int, int, int], faces: int
) -> None:
    solid = np.zeros(shape, np.bool_)
    south, north, west, east = wall
    solid[south:north, west:east] = True
    mesh = wall_mesh(WallGrid(solid, 0.5))
    assert len(mesh.faces) == faces
