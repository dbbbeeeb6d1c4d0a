"""Pixels without a height: declared, given, or only suspected."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from lirs_wct.sources.options import BuildOptions
from lirs_wct.sources.pictures.elevation import warn_nodata_border
from lirs_wct.sources.pictures.picture import read_height_field

HILLS = 3000 + 40 * np.sin(np.arange(40) / 6)[:, None] + 30 * np.cos(np.arange(50) / 5)[None, :]


def asc(path: Path, heights: np.ndarray) -> Path:
    rows, cols = heights.shape
    text = f"ncols {cols}\nnrows {rows}\nxllcorner 500000\nyllcorner 4000000\ncellsize 10\n"
    path.write_text(text + "\n".join(" ".join(f"{z:.3f}" for z in row) for row in heights) + "\n")
    return path


def framed(width: int) -> np.ndarray:
    heights = HILLS.copy()
    heights[:width], heights[:, -width:] = 0.0, 0.0
    return heights


def test_a_border_of_zeros_beside_mountains_is_told_in_one_line(tmp_path: Path) -> None:
    path = asc(tmp_path / "a.asc", framed(3))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        surface = read_height_field(path, BuildOptions())
    (line,) = (str(each.message) for each in told)
    assert line.startswith(f"{path}: 261 pixels of 0 along the border stand beside heights 30")
    assert line.endswith("say --nodata 0")
    assert surface.relief > 2900
    with pytest.warns(UserWarning, match=r"a\.asc: 261 of 2000 pixels have no height"):
        assert read_height_field(path, BuildOptions(nodata=0.0)).relief < 150


@pytest.mark.parametrize(
    "heights",
    [
        HILLS,
        np.maximum(HILLS - 3020, 0),  # the sea before a coast
        np.where(np.arange(50) < 20, 0.0, np.arange(50) * 4.0 - 76)[None, :] * np.ones((40, 1)),  # a plain
        np.where((np.arange(50) > 20) & (np.arange(50) < 30), 100.0, 0.0)[None, :] * np.ones((40, 1)) / 3,
    ],
)
def test_seas_and_plains_are_ground(heights: np.ndarray, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_height_field(asc(tmp_path / "a.asc", heights), BuildOptions())


def test_zeros_inside_or_declared_are_no_question() -> None:
    hole = HILLS.copy()
    hole[10:20, 10:20] = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_nodata_border(Path("a.asc"), hole, 1.0)
        warn_nodata_border(Path("a.asc"), np.zeros((5, 5)), 1.0)
    with pytest.warns(UserWarning, match="pixels of 0 along the border"):
        warn_nodata_border(Path("a.asc"), framed(1), 1.0)
