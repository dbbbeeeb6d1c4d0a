import cv2
import numpy as np
import pytest

from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.meshing.simplify import triangulate
from lirs_wct.sources.pictures.filters import dequantize


def hills(n: int = 257) -> np.ndarray:
    """(n, n) float32 0 to 255, smooth."""
    z = cv2.GaussianBlur(np.random.default_rng(7).standard_normal((n, n)).astype(np.float32), (0, 0), n / 16)
    return (z - z.min()) / np.ptp(z) * 255


@pytest.mark.parametrize("step", [1.0, 257.0])
def test_within_half_a_level_and_close_to_what_was_cut(step: float) -> None:
    true = hills()
    levels = np.round(true)
    smooth = dequantize(levels * np.float32(step), step) / step
    assert np.abs(smooth - levels).max() <= 0.5 + 1e-4
    before, after = ((a - true).std() for a in (levels, smooth))
    assert after < before / 3


def test_few_triangles_again() -> None:
    true = hills(513)
    levels = np.round(true)

    def triangles(z: np.ndarray) -> int:
        surface = HeightField.centered((z / 255).astype(np.float32), (1, 1))
        return len(triangulate(surface, max_error=5e-4)[1])

    exact, stairs, smooth = triangles(true), triangles(levels), triangles(dequantize(levels))
    assert stairs > 4 * exact
    assert smooth <= 1.5 * exact


def test_steps_higher_than_a_level_stay() -> None:
    levels = np.zeros((40, 40), np.float32)
    levels[:, 20:] = 100
    smooth = dequantize(levels)
    assert np.abs(smooth - levels).max() <= 0.5
    assert (smooth[:, 20] - smooth[:, 19]).min() >= 99


def test_level_ground_stays() -> None:
    np.testing.assert_array_equal(dequantize(np.full((7, 5), 3, np.float32)), np.full((7, 5), 3))


@pytest.mark.parametrize("shape", [(2, 2), (2, 900), (37, 16)])
def test_any_shape(shape: tuple[int, int]) -> None:
    levels = np.random.default_rng(0).integers(0, 255, shape).astype(np.float32)
    assert np.abs(dequantize(levels) - levels).max() <= 0.5
