"""The options that change a picture before it becomes a terrain."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.heightfield import resample
from lirs_wct.sources.picture import apply_filters
from lirs_wct.sources.source import BuildOptions
from tests.kit import read_heights as read

RAMP = np.tile(np.arange(40, dtype=np.float32), (30, 1))


def png(folder: Path, pixels: np.ndarray) -> Path:
    path = folder / "a.png"
    assert cv2.imwrite(str(path), pixels)
    return path


def noise(rows: int = 60, cols: int = 80) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 65535, (rows, cols), np.uint16)


def filtered(values: np.ndarray, **options: Any) -> np.ndarray:
    return apply_filters(values, BuildOptions(**options))


def test_median_takes_single_wrong_pixels_away() -> None:
    holed = RAMP.copy()
    holed[10, 10] = 500
    np.testing.assert_allclose(filtered(holed, denoise="median")[3:-3, 3:-3], RAMP[3:-3, 3:-3], atol=1)


def test_bilateral_keeps_edges_and_smooths_noise() -> None:
    step = np.zeros((40, 40), np.float32)
    step[:, 20:] = 100
    noisy = step + np.random.default_rng(1).normal(0, 1, step.shape).astype(np.float32)
    clean = filtered(noisy, denoise="bilateral")
    assert (clean - step).std() < 0.5
    assert (clean[:, 20] - clean[:, 19]).min() > 95


def test_smoothing_and_sharpness_pull_against_each_other() -> None:
    rough = noise().astype(np.float32)
    assert filtered(rough, smoothing=2.0).std() < rough.std() / 4
    assert filtered(rough, sharpness=1.0).std() > 1.5 * rough.std()
    np.testing.assert_allclose(filtered(RAMP, sharpness=2.0)[:, 9:-9], RAMP[:, 9:-9], atol=1e-4)


PLANE = RAMP + np.arange(30, dtype=np.float32)[:, None]


@pytest.mark.parametrize("size", [(79, 59), (41, 30), (400, 31)])
def test_enlarged_keeps_a_plane_to_its_corners(size: tuple[int, int]) -> None:
    expected = np.linspace(0, 39, size[0]) + np.linspace(0, 29, size[1])[:, None]
    np.testing.assert_allclose(resample(PLANE, *size), expected, atol=1e-4)
    np.testing.assert_array_equal(resample(PLANE, 40, 30), PLANE)


def test_shrunk_folds_nothing_fine_into_the_coarse() -> None:
    small = resample(PLANE, 14, 30)
    # The blur is level beyond the border: a plane bends there and nowhere else.
    np.testing.assert_allclose(small[5, 2:-2], PLANE[5, ::3][2:-2], atol=1e-2)
    stripes = np.tile(np.float32([0, 1]), (30, 60))
    assert np.ptp(resample(stripes, 20, 30)[:, 2:-2]) < 0.2
    assert resample(PLANE, 2, 2).shape == (2, 2)


def test_resize_keeps_the_meters(tmp_path: Path) -> None:
    surface = read(png(tmp_path, noise()), resolution=0.5, resize=(20, 30))
    assert surface.shape == (30, 20)
    assert surface.size == pytest.approx((79 * 0.5, 59 * 0.5))
    assert surface.relief == pytest.approx(6)


def test_deterrace_knows_8_bits_stored_as_16(tmp_path: Path) -> None:
    levels = np.tile((np.arange(200) // 20), (50, 1)).astype(np.uint16)
    first, *others = (
        read(png(tmp_path, levels * factor), deterrace=True, height=9.0).z for factor in (1, 257, 256)
    )
    # Ten stairs of one level become a ramp: no step is left of more than a tenth of a level.
    assert np.abs(np.diff(first[25])).max() < 0.1 * 1.2
    for z in others:
        np.testing.assert_allclose(z, first, atol=1e-4)


@pytest.mark.parametrize(
    "options",
    [
        {"denoise": "median"},
        {"denoise": "bilateral"},
        {"smoothing": 3.0},
        {"smoothing": 2.0, "sharpness": 1.0},
    ],
)
def test_filters_keep_shape_size_and_relief(tmp_path: Path, options: dict[str, object]) -> None:
    path = png(tmp_path, noise())
    surface = read(path, **options)
    assert surface.cell == read(path).cell
    assert (surface.z.min(), surface.z.max()) == (0, 6)
    assert np.abs(surface.z - read(path).z).max() > 0.1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_error": 0.1, "max_triangles": 100}, "max-error, max-triangles"),
        ({"denoise": "magic"}, "denoise must be median or bilateral, got 'magic'"),
        ({"crop": (-1, 0, 5, 5)}, "crop needs"),
        ({"resize": (1, 5)}, "resize needs"),
        ({"smoothing": 0.0}, "smoothing must be"),
        ({"scale": (1.0, -1.0, 1.0)}, "scale must be"),
        ({"rotate_x": float("nan")}, "x rotation must be finite"),
    ],
)
def test_illegal_options_are_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        BuildOptions(**options)  # type: ignore[arg-type]
