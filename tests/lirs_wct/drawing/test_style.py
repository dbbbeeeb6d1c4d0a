"""Figures as files: laid out and drawn as Matplotlib does it, but once."""

from io import BytesIO
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray
from PIL import Image

from lirs_wct.drawing.canvas import Drawing, new_figure, title


@pytest.fixture
def figure() -> Drawing:
    figure = new_figure(3.0, 2.0)
    for k in (1, 2):
        axes = figure.add_subplot(1, 2, k)
        axes.imshow(np.arange(12.0).reshape(3, 4))
        axes.set_ylabel("a label that needs room")
        title(axes, "Panel")
    return figure


def pixels(file: BytesIO) -> NDArray[np.uint8]:
    return np.asarray(Image.open(file))


@pytest.mark.parametrize("dpi", [None, 72])
def test_pixels_are_those_of_matplotlib(figure: Drawing, dpi: int | None) -> None:
    ours, theirs = BytesIO(), BytesIO()
    figure.savefig(ours, dpi=dpi)
    Figure.savefig(figure, theirs, dpi=dpi or figure.dpi)
    assert np.array_equal(pixels(ours), pixels(theirs))


def test_images_are_resampled_once(figure: Drawing) -> None:
    with patch.object(AxesImage, "make_image", autospec=True, side_effect=AxesImage.make_image) as made:
        figure.savefig(BytesIO())
    assert made.call_count == 2


def test_figure_is_left_as_it_was(figure: Drawing) -> None:
    engine, dpi = figure.get_layout_engine(), figure.dpi
    figure.savefig(BytesIO(), dpi=50)
    assert figure.get_layout_engine() is engine
    assert figure.dpi == dpi


@pytest.mark.parametrize("suffix", ["pdf", "svg", "png"])
def test_kind_of_file_follows_its_name(figure: Drawing, suffix: str, tmp_path: Path) -> None:
    figure.savefig(tmp_path / f"picture.{suffix}")
    begin = {"pdf": b"%PDF", "svg": b"<?xml", "png": b"\x89PNG"}[suffix]
    assert (tmp_path / f"picture.{suffix}").read_bytes().startswith(begin)
