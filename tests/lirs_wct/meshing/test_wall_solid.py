"""A laser map as one closed solid: as large as its cells, closed where they touch at corners."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from lirs_wct.formats.meshes.writers import write_stl
from lirs_wct.geometry.grid import WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.meshing.solid import SLAB, wall_mesh

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
