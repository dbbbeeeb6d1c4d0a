"""Figures as files."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
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


@pytest.mark.parametrize("suffix", ["pdf", "svg", "png"])
def test_kind_of_file_follows_its_name(figure: Drawing, suffix: str, tmp_path: Path) -> None:
    figure.savefig(tmp_path / f"picture.{suffix}")
    begin = {"pdf": b"%PDF", "svg": b"<?xml", "png": b"\x89PNG"}[suffix]
    assert (tmp_path / f"picture.{suffix}").read_bytes().startswith(begin)
