"""Grids sampled on others over the same ground."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lirs_wct.geometry.grid_sampling import resample


@given(st.integers(2, 9), st.integers(2, 9), st.integers(0, 12), st.integers(0, 12))
def test_finer_grids_lie_on_straight_lines_between_the_nodes(
    rows: int, cols: int, more: int, wide: int
) -> None:
    z = np.random.default_rng(rows * 10 + cols).normal(size=(rows, cols)).astype(np.float32)
    found = resample(z, cols + wide, rows + more)
    assert (found.shape, found.dtype) == ((rows + more, cols + wide), np.float32)
    x, y = np.linspace(0, cols - 1, cols + wide), np.linspace(0, rows - 1, rows + more)
    across = np.array([np.interp(x, np.arange(cols), row) for row in z])
    expected = np.array([np.interp(y, np.arange(rows), column) for column in across.T]).T
    np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_allclose(
        found[[0, 0, -1, -1], [0, -1, 0, -1]], z[[0, 0, -1, -1], [0, -1, 0, -1]], atol=1e-6
    )


@pytest.mark.parametrize(("width", "height"), [(20, 31), (60, 16), (20, 16), (61, 16), (21, 61)])
def test_coarser_grids_are_blurred_by_half_of_what_they_shrink(width: int, height: int) -> None:
    """Of 61 x 31 nodes; the axis that does not shrink is blurred by next to nothing."""
    z = np.random.default_rng(3).normal(size=(31, 61)).astype(np.float32)
    sigmas = [max((61 - 1) / (width - 1) - 1, 2e-3) / 2, max((31 - 1) / (height - 1) - 1, 2e-3) / 2]
    blurred = cv2.GaussianBlur(z, (0, 0), sigmas[0], sigmaY=sigmas[1], borderType=cv2.BORDER_REPLICATE)
    expected = resample(np.repeat(blurred, 1, axis=0), 61, 31)  # as large: no blur
    np.testing.assert_array_equal(expected, blurred)
    x, y = np.linspace(0, 60, width), np.linspace(0, 30, height)
    across = np.array([np.interp(x, np.arange(61), row) for row in blurred])
    expected = np.array([np.interp(y, np.arange(31), column) for column in across.T]).T
    np.testing.assert_allclose(resample(z, width, height), expected, atol=1e-5)


def test_the_same_grid_stays_to_the_bit() -> None:
    z = np.random.default_rng(3).normal(size=(5, 4)).astype(np.float32)
    np.testing.assert_array_equal(resample(z, 4, 5), z)
