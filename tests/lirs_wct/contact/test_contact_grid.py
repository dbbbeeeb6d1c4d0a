"""The contact grid keeps its budget, as an independent measure confirms, and is no finer than it must be."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lirs_wct.contact.grid import ContactGrid, contact_grid, steep_nodes
from lirs_wct.contact.parts import bodies, convex_parts
from lirs_wct.geometry.heightfield import HeightField
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
    monkeypatch.setattr("lirs_wct.contact.grid.VERTICAL", 0.05)
    assert contact_grid(surface).stride > grid.stride


@pytest.mark.parametrize("first", range(8, 12))
def test_a_step_is_kept_to_half_a_contact_cell(first: int) -> None:
    z = np.zeros((41, 41))
    for column in (first, first + 10, first + 20):
        z[:, column:] += 1.5
    grid = contact_grid(field(z))
    # A face over one cell fits a ramp over two, wherever it stands; over three only in its middle.
    assert grid.stride == 2
    vertical, horizontal = deviations(field(z), grid)
    assert vertical <= 0.01
    assert horizontal <= grid.horizontal_budget == pytest.approx(0.05)
    assert grid.horizontal == pytest.approx(0.05)


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
