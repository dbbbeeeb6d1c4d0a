"""Few triangles within a budget, held at and between pixels."""

import itertools
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lirs_validation.metrics.world_geometry import mesh_error
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import TriangleMesh, rasterize_heights
from lirs_wct.ground import ExportOptions, Terrain
from lirs_wct.meshing.simplify import simplified_solid, triangulate
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.world import World
from tests.kit import read_heights


def hills(rows: int, cols: int, seed: int = 0, blur: float = 3.0) -> HeightField:
    z = np.random.default_rng(seed).random((rows, cols)).astype(np.float32)
    z = cv2.GaussianBlur(z, (0, 0), blur) if blur else z
    return HeightField.centered(z - z.min(), (0.5, 0.25))


def errors(surface: HeightField, points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(rows, cols) difference at every pixel, NaN where no triangle is: plain barycentric coordinates."""
    out = np.full(surface.shape, np.nan)
    for triangle in points[faces].astype(float):
        (r0, c0), (r1, c1) = triangle.min(axis=0).astype(int), triangle.max(axis=0).astype(int)
        r, c = np.mgrid[r0 : r1 + 1, c0 : c1 + 1]
        (ar, ac), (br, bc), (cr, cc) = triangle
        area = (br - ar) * (cc - ac) - (bc - ac) * (cr - ar)
        v = ((r - ar) * (cc - ac) - (c - ac) * (cr - ar)) / area
        w = ((br - ar) * (c - ac) - (bc - ac) * (r - ar)) / area
        inside = (v >= -1e-12) & (w >= -1e-12) & (v + w <= 1 + 1e-12)
        za, zb, zc = (float(surface.z[int(i), int(j)]) for i, j in triangle)
        plane = za + v * (zb - za) + w * (zc - za)
        out[r[inside], c[inside]] = (plane - surface.z[r, c])[inside]
    return out


@given(
    st.integers(2, 40),
    st.integers(2, 40),
    st.integers(0, 9),
    st.sampled_from([0.0, 2.0]),
    st.sampled_from([0.5, 0.1, 0.01, 1e-5]),
)
def test_the_budget_holds_at_every_pixel(rows: int, cols: int, seed: int, blur: float, share: float) -> None:
    surface = hills(rows, cols, seed, blur)
    budget = max(share * surface.relief, 1e-9)
    points, faces = triangulate(surface, max_error=budget)
    off = errors(surface, points, faces)
    assert not np.isnan(off).any()
    assert np.abs(off).max() <= max(budget, 2e-6 * surface.relief)
    on_border = np.isin(points[:, 0], (0, rows - 1)) | np.isin(points[:, 1], (0, cols - 1))
    assert len(faces) == 2 * len(points) - on_border.sum() - 2  # Euler: a disc without holes
    mesh = simplified_solid(surface, max_error=budget)
    assert mesh.is_watertight
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_volume


def error_between(surface: HeightField, mesh: TriangleMesh, fractions: tuple[float, ...]) -> float:
    """Largest difference of the mesh from the height field at fractions of every cell, meters."""
    (x, y), (dx, dy), (rows, cols) = surface.origin, surface.cell, surface.shape
    largest = 0.0
    for u, v in itertools.product(fractions, repeat=2):
        top = rasterize_heights(mesh, (x + u * dx, y + v * dy, dx, dy), (rows - 1, cols - 1))
        px, py = x + (np.arange(cols - 1) + u) * dx, y + (np.arange(rows - 1) + v) * dy
        largest = max(largest, float(np.abs(top - surface.height_at(*np.meshgrid(px, py))).max()))
    return largest


@given(
    st.integers(2, 30),
    st.integers(2, 30),
    st.integers(0, 99),
    st.sampled_from([0.0, 1.0, 3.0]),
    st.sampled_from([3, 20, 65535]),
    st.sampled_from([0.4, 0.1, 0.01]),
)
def test_the_budget_holds_between_pixels(
    rows: int, cols: int, seed: int, blur: float, levels: int, share: float
) -> None:
    """Also where a picture has few levels, upright steps and cells with two possible diagonals."""
    surface = hills(rows, cols, seed, blur)
    z = np.rint(surface.z / surface.relief * levels).astype(np.float32)
    surface = HeightField.centered(z, (0.5, 0.25))
    mesh = simplified_solid(surface, max_error=share * levels)
    assert mesh.is_watertight
    assert error_between(surface, mesh, (0.01, 0.25, 0.5, 0.75, 0.99)) <= share * levels * (1 + 1e-6)


def test_a_mesh_of_all_pixels_is_the_height_field() -> None:
    """Every cell has the height field's diagonal, though both are Delaunay."""
    surface = hills(40, 50, blur=0.0)
    mesh = simplified_solid(surface, max_error=1e-5 * surface.relief)
    assert len(mesh.faces) == len(solid_mesh(surface).faces)
    assert error_between(surface, mesh, (0.25, 0.5, 0.75)) <= 1e-6 * surface.relief


@pytest.mark.shared
@pytest.mark.parametrize(
    "name",
    [
        "gz-common__dem_landscape.tif",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("pydelatin__fuji.png", "hmstl__mask.png")),
    ],
)
def test_the_default_budget_holds_between_pixels_of_real_pictures(shared_data: Path, name: str) -> None:
    surface = read_heights(shared_data / "height" / name, grayscale=True)
    budget = ExportOptions().with_default(surface).max_error
    assert budget is not None
    mesh = simplified_solid(surface, max_error=budget)
    assert error_between(surface, mesh, (0.125, 0.5, 0.875)) <= budget


def test_faces_look_up_and_cover_the_rectangle_once() -> None:
    surface = hills(60, 80)
    points, faces = triangulate(surface, max_error=0.02 * surface.relief)
    (a, b, c) = (points[faces[:, k]].astype(float) for k in range(3))
    # East is +column, north is -row.
    doubled = (b[:, 1] - a[:, 1]) * (a[:, 0] - c[:, 0]) - (a[:, 0] - b[:, 0]) * (c[:, 1] - a[:, 1])
    assert (doubled > 0).all()
    assert doubled.sum() / 2 == 59 * 79


def test_triangles_are_delaunay() -> None:
    surface = hills(40, 50)
    points, faces = triangulate(surface, max_error=0.05 * surface.relief)
    for triangle in points[faces].astype(float):
        a = np.column_stack((2 * triangle, np.ones(3)))
        *center, k = np.linalg.solve(a, (triangle**2).sum(axis=1))
        radius2 = k + np.dot(center, center)
        assert (((points - center) ** 2).sum(axis=1) >= radius2 - 1e-6 * radius2).all()


def test_edges_are_straight_and_the_box_is_the_fields() -> None:
    surface = hills(60, 80)
    mesh = simplified_solid(surface, max_error=0.02 * surface.relief)
    whole = solid_mesh(surface)
    np.testing.assert_array_equal(mesh.bounds[:, :2], whole.bounds[:, :2])
    assert mesh.bounds[0, 2] == whole.bounds[0, 2]
    sides = np.abs(mesh.face_normals[:, 2]) < 1e-9
    for a, b in zip(mesh.vertices[mesh.faces[sides]], mesh.face_normals[sides], strict=True):
        axis = int(np.abs(b).argmax())
        assert (a[:, axis] == whole.bounds[int(b[axis] > 0), axis]).all()


@pytest.mark.parametrize("most", [14, 15, 100, 1001])
def test_never_more_triangles_than_asked(most: int) -> None:
    mesh = simplified_solid(hills(60, 80), max_triangles=most)
    assert most - 4 < len(mesh.faces) <= most
    assert mesh.is_watertight


def test_the_worst_pixel_goes_in_next() -> None:
    """Greedy to one bin of the queue: 1/128 of the error."""
    surface = hills(30, 40, blur=1.0)
    whole = triangulate(surface, max_triangles=400)[0]
    for most in range(14, 140, 5):
        points, faces = triangulate(surface, max_triangles=most)
        np.testing.assert_array_equal(points, whole[: len(points)])
        off = np.abs(errors(surface, points, faces))
        assert off[tuple(whole[len(points)])] >= off.max() / (1 + 1 / 128)


def test_long_thin_pictures() -> None:
    z = np.random.default_rng(3).random((3, 20_000)).astype(np.float32)
    z[1, 10_000], z[0, 17] = 5, 4
    surface = HeightField.centered(z, (1, 1))
    points, faces = triangulate(surface, max_error=1.0)
    assert len(faces) < 40
    assert np.abs(errors(surface, points, faces)).max() <= 1.0
    assert simplified_solid(surface, max_error=1.0).is_watertight


def test_flat_and_almost_flat_ground_needs_few_triangles() -> None:
    """The default budget is at least a millionth of the longer side."""
    column, row = np.meshgrid(np.arange(80, dtype=np.float32), np.arange(60, dtype=np.float32))
    rounding = np.random.default_rng(1).normal(0, 1e-6, (60, 80)).astype(np.float32)
    dent = np.zeros((60, 80), np.float32)
    dent[20, 30] = 0.01
    grounds = {14: (0 * column, rounding, 0.05 * column + 0.02 * row + rounding), 40: (dent,)}
    for most, heights in grounds.items():
        for z in heights:
            world = World("ground", Terrain(HeightField.centered(z, (0.5, 0.5))))
            assert len(world.file_mesh.faces) <= most
            assert mesh_error(world, world.file_mesh) <= max(1e-6 * 39.5, 1e-3 * world.surface.relief)
    exact = replace(world, export_options=ExportOptions(max_error=0))
    assert len(exact.file_mesh.faces) > 2 * 59 * 79


def test_the_budget_holds_in_float32() -> None:
    """Mesh files hold float32 positions, which move rough ground far from the origin."""
    rough = np.random.default_rng(4).random((50, 60)).astype(np.float32)
    surface = HeightField(rough * 10, (0.01, 0.01), (4000.0, 4000.0))
    world = World("rough", Terrain(surface))
    mesh = simplified_solid(surface, max_error=1.0)
    read = TriangleMesh(mesh.vertices.astype(np.float32).astype(np.float64), mesh.faces)
    assert mesh_error(world, read) <= 1.0


def test_budgets_are_checked() -> None:
    surface = hills(5, 5)
    for budgets in ({}, {"max_error": 1.0, "max_triangles": 20}):
        with pytest.raises(ConfigError, match=r"max-error, max-triangles"):
            simplified_solid(surface, **budgets)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="max error must be"):
        simplified_solid(surface, max_error=0.0)
    with pytest.raises(ConfigError, match="max triangles must be at least 14"):
        simplified_solid(surface, max_triangles=13)
