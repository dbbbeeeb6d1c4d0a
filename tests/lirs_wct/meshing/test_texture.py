"""Cube projection: continuous from ground to skirt, normals right, nothing moved."""

import numpy as np
import pytest
import trimesh

from lirs_wct.errors import ConfigError
from lirs_wct.export.appearance import cube_uv, draped_uv, wall_uv
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.solid import solid_mesh


def hills(rows: int = 20, cols: int = 30, height: float = 1.0) -> HeightField:
    rng = np.random.default_rng(3)
    z = np.cumsum(np.cumsum(rng.normal(size=(rows, cols)), 0), 1)
    z = (z - z.min()) / np.ptp(z) * height
    return HeightField.centered(z.astype(np.float32), (0.5, 0.5))


def box() -> TriangleMesh:
    cube = trimesh.creation.box(extents=(2, 4, 1))
    return TriangleMesh(np.asarray(cube.vertices, float), np.asarray(cube.faces, np.int32))


def test_the_shape_is_untouched() -> None:
    mesh = solid_mesh(hills())
    textured = cube_uv(mesh)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], textured.vertices[textured.faces])
    assert trimesh.Trimesh(textured.vertices, textured.faces).is_watertight


def test_gentle_ground_is_seen_from_above_and_one_texture_spans_it() -> None:
    surface = hills()
    textured = cube_uv(solid_mesh(surface))
    assert textured.uv is not None
    ground = textured.normals[:, 2] > 0.5  # type: ignore[index]
    assert ground.sum() == surface.z.size
    span = max(surface.size)
    expected = (textured.vertices[ground, :2] - (surface.bounds[0], surface.bounds[1])) / span
    np.testing.assert_allclose(textured.uv[ground], expected, atol=1e-12)
    assert textured.uv[ground].min() == 0
    assert textured.uv[ground].max() == pytest.approx(1)


def test_no_seam_between_ground_and_skirt() -> None:
    """Every place on the rim has one texture coordinate, but for the four corners' two skirts."""
    textured = cube_uv(solid_mesh(hills()))
    assert textured.uv is not None
    assert textured.normals is not None
    skirt = np.abs(textured.normals[:, 2]) < 1e-9
    ground = textured.normals[:, 2] > 0.5
    uv_of = {tuple(p): uv for p, uv in zip(textured.vertices[ground], textured.uv[ground], strict=True)}
    rim = [i for i in np.flatnonzero(skirt) if tuple(textured.vertices[i]) in uv_of]
    assert len(rim) == 2 * (20 + 30 - 2) + 4
    for i in rim:
        np.testing.assert_allclose(textured.uv[i], uv_of[tuple(textured.vertices[i])], atol=1e-12)


def areas(mesh: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return twice the area of each triangle, in space and in the texture."""
    assert mesh.uv is not None
    corners, flat = mesh.vertices[mesh.faces], mesh.uv[mesh.faces]
    u, v = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return area, np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def test_texels_on_the_skirt_are_as_large_as_on_the_ground() -> None:
    textured = cube_uv(solid_mesh(hills()), size=2.0)
    skirt = np.abs(textured.face_normals[:, 2]) < 1e-9
    area, area_uv = areas(textured)
    np.testing.assert_allclose(area_uv[skirt].sum() * 2.0**2, area[skirt].sum(), rtol=1e-9)


def test_steep_ground_is_seen_from_the_side() -> None:
    textured = cube_uv(solid_mesh(hills(height=30.0)))
    area, area_uv = areas(textured)
    area_uv *= np.ptp(textured.bounds, axis=0).max() ** 2
    ground = textured.face_normals[:, 2] > 1e-6
    steep = textured.face_normals[:, 2] < 0.5
    assert (ground & steep).sum() > 100
    # The dominant axis sees at least 1/sqrt(3) of every face, so nothing is stretched by more.
    assert (area_uv[ground] >= area[ground] / np.sqrt(3) * (1 - 1e-9)).all()


def test_vertical_faces_of_any_outline_are_not_striped() -> None:
    """The face of a standing ring, whose edges run in all directions: texels as large as on its top."""
    ring = trimesh.creation.annulus(1.0, 2.0, 1.5)
    ring.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    textured = cube_uv(TriangleMesh(np.asarray(ring.vertices), np.asarray(ring.faces, np.int32)), size=1.0)
    area, area_uv = areas(textured)
    caps = np.abs(textured.face_normals[:, 1]) > 0.99
    np.testing.assert_allclose(area_uv[caps], area[caps], rtol=1e-9)


def test_a_box_keeps_its_edges_sharp() -> None:
    textured = cube_uv(box())
    assert textured.normals is not None
    assert len(textured.vertices) == 24
    np.testing.assert_allclose(np.abs(textured.normals).max(axis=1), 1)
    np.testing.assert_allclose(textured.normals[textured.faces[:, 0]], textured.face_normals, atol=1e-12)


def test_normals_are_those_of_the_surface() -> None:
    x = np.linspace(0, 0.5, 11, dtype=np.float32)
    plane = HeightField.centered(np.tile(x, (6, 1)), (0.1, 0.3))
    textured = cube_uv(solid_mesh(plane))
    assert textured.normals is not None
    ground = textured.normals[:, 2] > 0.1
    np.testing.assert_allclose(textured.normals[ground], [[-(0.2**0.5), 0, 0.8**0.5]] * 66, atol=1e-5)


def test_a_draped_picture_lies_where_it_is_seen_from_above() -> None:
    """On steep ground too, where cube projection took the color of another height."""
    surface = hills(height=30.0)
    mesh = draped_uv(solid_mesh(surface), surface.bounds)
    assert mesh.uv is not None
    west, south, _, _ = surface.bounds
    np.testing.assert_allclose(mesh.uv, (mesh.vertices[:, :2] - (west, south)) / surface.size, atol=1e-12)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight


def test_a_draped_picture_keeps_its_border_to_itself() -> None:
    surface = hills()
    mesh = draped_uv(solid_mesh(surface), surface.bounds, margin=0.01)
    assert mesh.uv is not None
    assert mesh.uv.min() == 0.01
    assert mesh.uv.max() == 0.99


def test_draped_ground_is_smooth_and_its_skirt_sharp() -> None:
    surface = hills(height=30.0)
    mesh, cube = draped_uv(solid_mesh(surface), surface.bounds), cube_uv(solid_mesh(surface))
    assert mesh.normals is not None
    assert cube.normals is not None
    assert len(mesh.vertices) < len(cube.vertices)
    np.testing.assert_allclose(mesh.normals[mesh.faces], cube.normals[cube.faces], atol=1e-12)


def test_a_texture_stands_upright_on_each_side_of_a_wall() -> None:
    """v rises with z from the floor; u runs to the right of who stands before the wall; texels are square."""
    solid = box()
    lifted = TriangleMesh(solid.vertices + np.array((7.0, 3.0, 0.5)), solid.faces)
    mesh = wall_uv(lifted, size=2.0)
    assert mesh.uv is not None
    assert mesh.normals is not None
    sides = np.abs(mesh.normals[:, 2]) < 1e-9
    np.testing.assert_allclose(mesh.uv[sides, 1], mesh.vertices[sides, 2] / 2.0)
    right = np.cross((0, 0, 1), mesh.normals[sides])
    np.testing.assert_allclose(mesh.uv[sides, 0], (mesh.vertices[sides] * right).sum(axis=1) / 2.0)
    tops = mesh.normals[:, 2] > 0.5
    np.testing.assert_allclose(mesh.uv[tops], mesh.vertices[tops, :2] / 2.0)


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan")])
def test_an_impossible_size_is_refused(size: float) -> None:
    with pytest.raises(ConfigError, match="texture size must be"):
        cube_uv(box(), size)
