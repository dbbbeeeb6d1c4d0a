"""A height field is the surface of its own triangles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.heightfield import HeightField

fields = st.builds(
    HeightField.centered,
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=7),
        elements=st.floats(-5, 5, width=32),
    ),
    st.tuples(st.floats(0.05, 3), st.floats(0.05, 3)),
)
shares = st.floats(0, 1)


@given(fields)
def test_nodes_are_met_exactly_with_row_0_in_the_north(field: HeightField) -> None:
    rows, cols = field.shape
    west, south, east, north = field.bounds
    x, y = np.linspace(west, east, cols), np.linspace(north, south, rows)
    heights = field.height_at(np.clip(x, west, east)[None, :], np.clip(y, south, north)[:, None])
    np.testing.assert_allclose(heights, field.z, atol=1e-4)


@given(fields, shares, shares)
def test_heights_between_nodes_stay_between_the_cells_corners(field: HeightField, u: float, v: float) -> None:
    west, south, east, north = field.bounds
    height = field.height_at(west + u * (east - west), south + v * (north - south))
    assert np.isnan(height) or field.z.min() - 1e-4 <= height <= field.z.max() + 1e-4


def test_a_cell_splits_from_south_west_to_north_east() -> None:
    z = np.array([[0, 1], [1, 0]], np.float32)  # north row first: NW 0, NE 1, SW 1, SE 0
    field = HeightField(z, (1.0, 1.0), (0.0, 0.0))
    assert field.height_at(0.5, 0.5) == 1.0
    assert field.height_at(0.75, 0.25) == pytest.approx(0.5)


def test_off_the_field_there_is_no_height() -> None:
    field = HeightField.centered(np.zeros((3, 3), np.float32), (1.0, 1.0))
    assert np.isnan(field.height_at(1.01, 0.0))
    assert field.height_at(1.0, -1.0) == 0.0


@pytest.mark.parametrize("z", [np.zeros((1, 5)), np.full((2, 2), np.nan), np.zeros(4)])
def test_what_is_no_terrain_is_refused(z: np.ndarray) -> None:
    with pytest.raises(ConfigError):
        HeightField(z.astype(np.float32), (1.0, 1.0), (0.0, 0.0))
