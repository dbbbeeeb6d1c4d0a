"""The bundled worlds are what they claim to be."""

import math
from functools import cache

import cv2
import numpy as np
import pytest

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.sources.bundled import PIXELS, RECIPES, SIZE, BundledPicture, bundled_picture

CELL = SIZE / (PIXELS - 1)
CLAIMS = {"simple": (4.0, 0.5, 1), "medium": (10.0, 2.0, 2), "advanced": (18.0, 5.0, 4)}
NAMES = ["simple", *(pytest.param(name, marks=pytest.mark.slow) for name in RECIPES if name != "simple")]


def slope_over(z: FloatArray, meters: float, cell: float) -> FloatArray:
    """Return slopes in degrees of heights (rows, cols) over a baseline in meters."""
    step = max(1, round(meters / cell / 2))
    dx = (z[step:-step, 2 * step :] - z[step:-step, : -2 * step]) / (2 * step * cell)
    dy = (z[2 * step :, step:-step] - z[: -2 * step, step:-step]) / (2 * step * cell)
    return np.degrees(np.arctan(np.hypot(dx, dy)))


@cache
def made(name: str) -> BundledPicture:
    return bundled_picture(name)


@pytest.mark.parametrize("name", NAMES)
def test_hills_have_the_slope_and_relief_they_claim(name: str) -> None:
    slope, relief, _ = CLAIMS[name]
    hills = made(name).hills
    assert np.percentile(slope_over(hills, 1.0, CELL), 95) == pytest.approx(slope, rel=0.2)
    assert np.ptp(hills) == pytest.approx(relief, rel=0.01)


@pytest.mark.parametrize("name", NAMES)
def test_obstacles_are_as_many_as_steep_and_as_tall_as_claimed(name: str) -> None:
    """Counted in the picture alone: connected rims of faces over 60 deg that rise at least 1 m."""
    picture = made(name)
    z = picture.pixels / 65535 * picture.height
    rise = cv2.morphologyEx(z, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    raised = (z - (picture.hills - picture.hills.min()) > 0.9).astype(np.uint8)
    count, labels = cv2.connectedComponents(raised)
    assert count - 1 == CLAIMS[name][2] * SIZE**2 / 100
    for label in range(1, count):
        rim = (labels == label) & (cv2.erode((labels == label).astype(np.uint8), np.ones((3, 3))) == 0)
        assert rise[rim].min() >= 1.0
        assert math.degrees(math.atan(rise[rim].min() / (2 * CELL))) > 60


@pytest.mark.parametrize("name", NAMES)
def test_the_same_picture_every_time(name: str) -> None:
    assert np.array_equal(made(name).pixels, bundled_picture(name).pixels)


def test_an_unknown_name_lists_the_legal_ones() -> None:
    with pytest.raises(ConfigError, match="advanced, medium, simple"):
        bundled_picture("hard")
