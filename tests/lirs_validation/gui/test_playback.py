"""Pictures and places of a page: clicked points, round lengths, colors, messages without flags and paths."""

import numpy as np
import pytest

pytest.importorskip("viser")

from lirs_validation.gui.controls import without_flags
from lirs_validation.gui.page import ABSOLUTE_PATH
from lirs_validation.gui.playback import MapSnapshot
from lirs_validation.gui.scene import error_colors, ground_point, round_length
from lirs_wct import HeightField, OccupancyGrid, Pose2

SLOPE = HeightField.centered(np.tile(np.linspace(0, 8, 41, dtype=np.float32), (41, 1)), (0.5, 0.5))
"""20 x 20 m, rising eastward from 0 to 8 m."""


def test_a_click_meets_the_ground_first_in_its_way() -> None:
    camera = np.array((0.0, -30.0, 20.0))
    for x, y in ((-6.0, 3.0), (0.0, 0.0), (8.0, -9.0)):
        toward = np.array((x, y, 0.4 * (x + 10))) - camera
        found = ground_point(SLOPE, camera, toward / np.linalg.norm(toward))
        assert found == pytest.approx((x, y), abs=0.4)
    assert ground_point(SLOPE, camera, (0.0, 0.0, 1.0)) is None
    assert ground_point(SLOPE, camera, (1.0, 0.0, -0.3)) is None


def test_a_kept_map_has_the_cells_of_a_maps_file() -> None:
    p = [[np.nan, 0.9, 0.5], [0.1, 0.66, 0.24]]
    grid = OccupancyGrid.from_probability(p, 0.05, Pose2(1.0, 2.0, 0.3))
    kept = MapSnapshot.of(grid, 7.0).grid
    np.testing.assert_array_equal(kept.occupied, grid.occupied)
    np.testing.assert_array_equal(kept.free, grid.free)
    np.testing.assert_array_equal(kept.known, grid.occupied | grid.free)
    assert (kept.resolution, kept.origin) == (grid.resolution, grid.origin)


@pytest.mark.parametrize(("length", "shorter"), [(10.0, 10.0), (9.9, 5.0), (0.7, 0.5), (2500, 2000), (4, 2)])
def test_scale_bars_have_round_lengths(length: float, shorter: float) -> None:
    assert round_length(length) == pytest.approx(shorter)


def test_colors_tell_small_from_large_errors() -> None:
    colors = error_colors(np.array((0.0, 0.5, 1.0))).astype(int)
    dark, _, bright = colors.sum(axis=1)
    assert dark < bright
    assert error_colors(np.array((0.0, 0.02)))[1, 1] < 50  # two centimeters are no large error
    assert colors[0, 2] > colors[0, 0]  # RGB: violet
    assert colors[2, 0] > 200 > colors[2, 2]  # yellow


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("give one of --size, --invert, --z-scale 2", "give one of size, color inverse, z axis scale 2"),
        ("/tmp/lirs-wct-gui-1-x/hill.png: not a picture", "hill.png: not a picture"),
        ("see /var/a b", "see a b"),
        ("2 m/s and 1/2 at http://127.0.0.1:8080/x stay", "2 m/s and 1/2 at http://127.0.0.1:8080/x stay"),
    ],
)
def test_messages_have_no_flags_and_no_folders(message: str, shown: str) -> None:
    assert ABSOLUTE_PATH.sub(r"\1", without_flags(message)) == shown
