"""Structural similarity against a plain twin of Wang's equations, and against scikit-image where it is."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_validation.metrics.map import as_picture, map_ssim, similarity
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2

WINDOW, SIGMA, K1, K2 = 11, 1.5, 0.01, 0.03  # the paper's


def pictures(seed: int, shape: tuple[int, int] = (31, 42)) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x = rng.choice((0.0, 0.5, 1.0), shape, p=(0.1, 0.3, 0.6))
    return x, np.where(rng.random(shape) < 0.15, rng.choice((0.0, 0.5, 1.0), shape), x)


def twin(x: np.ndarray, y: np.ndarray, row: int, col: int) -> float:
    """Wang et al., Eqs. 13-16, about one pixel, term by term."""
    reach = WINDOW // 2
    weights = np.array(
        [[math.exp(-(r * r + c * c) / (2 * SIGMA**2)) for c in range(-reach, reach + 1)]
         for r in range(-reach, reach + 1)]
    )  # fmt: skip
    weights /= weights.sum()
    # Mirrored at the borders, the outermost pixel twice.
    x, y = np.pad(x, reach, mode="symmetric"), np.pad(y, reach, mode="symmetric")
    square = np.s_[row : row + WINDOW, col : col + WINDOW]
    a, b = x[square], y[square]
    ma, mb = (weights * a).sum(), (weights * b).sum()
    va, vb = (weights * (a - ma) ** 2).sum(), (weights * (b - mb) ** 2).sum()
    cov = (weights * (a - ma) * (b - mb)).sum()
    c1, c2 = K1**2, K2**2
    return float((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2)))


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_against_the_equations(seed: int) -> None:
    x, y = pictures(seed)
    ours = similarity(x, y)
    rng = np.random.default_rng(seed)
    for row, col in zip(rng.integers(0, 31, 12).tolist(), rng.integers(0, 42, 12).tolist(), strict=True):
        assert ours[row, col] == pytest.approx(twin(x, y, row, col), abs=1e-9)


def test_against_scikit_image() -> None:
    metrics = pytest.importorskip("skimage.metrics")
    x, y = pictures(5, (120, 90))
    _, theirs = metrics.structural_similarity(
        x, y, gaussian_weights=True, sigma=SIGMA, use_sample_covariance=False, data_range=1.0, full=True
    )
    assert np.allclose(similarity(x, y), theirs, atol=1e-9)


def grid(p: np.ndarray, origin: Pose2 | None = None) -> OccupancyGrid:
    return OccupancyGrid.from_probability(p, 0.05, origin)


def test_a_map_resembles_itself_wherever_it_lies() -> None:
    p = np.random.default_rng(1).choice((np.nan, 0.1, 0.9), (40, 50))
    here = grid(p, Pose2(1.0, -2.0, 0.4))
    assert map_ssim(here, here) == pytest.approx(1.0)
    far = here.moved(Pose2(500.0, 0.0, 0.0))
    assert map_ssim(far, here) is None
    assert map_ssim(grid(np.full((9, 9), np.nan)), grid(np.full((9, 9), 0.1))) is None


def test_the_mean_is_over_the_cells_known_in_both() -> None:
    rng = np.random.default_rng(6)
    p, q = (rng.choice((np.nan, 0.1, 0.5, 0.9), (14, 23)) for _ in range(2))
    built = grid(p, Pose2(2.0, 3.0))
    reference = grid(q, Pose2(2.0 - 2 * 0.05, 3.0 + 3 * 0.05))  # two cells west, three north of it
    there = np.full((14, 23), np.nan)
    there[:-3, 2:] = p[3:, :-2]
    both = ~np.isnan(there) & ~np.isnan(q)
    expected = similarity(as_picture(grid(there)), as_picture(reference))[both].mean()
    assert map_ssim(built, reference) == pytest.approx(expected, abs=1e-9)


def test_the_picture_is_the_papers() -> None:
    shades = as_picture(grid(np.array([[np.nan, 0.05, 0.5, 0.95]])))
    assert shades.tolist() == [[0.5, 1.0, 0.5, 0.0]]
