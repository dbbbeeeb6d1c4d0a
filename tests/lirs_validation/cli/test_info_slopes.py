"""Slopes of `info` by strips are those of the whole surface."""

import numpy as np
import pytest

from lirs_validation.cli.commands.info import STRIP, _slopes
from lirs_wct.geometry.heightfield import HeightField


@pytest.mark.parametrize("rows", [2, STRIP, STRIP + 1, 2 * STRIP + 3])
def test_strips_are_the_whole(rows: int) -> None:
    z = np.random.default_rng(rows).random((rows, 5)).astype(np.float32)
    surface = HeightField.centered(z, (0.5, 0.2))
    np.testing.assert_allclose(_slopes(surface), np.degrees(surface.slope()), rtol=1e-6)
