"""Decoded pictures: sizes that are legal, what is warned of, and the decoder's log left as it was."""

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from lirs_wct.errors import SourceError
from lirs_wct.formats.images import tiff
from lirs_wct.formats.images.picture import check_size, read_picture

COLOR = np.random.default_rng(4).integers(0, 255, (5, 7, 4), np.uint8)


def png(folder: Path, pixels: np.ndarray) -> Path:
    assert cv2.imwrite(str(folder / "a.png"), pixels)
    return folder / "a.png"


@pytest.mark.parametrize(
    ("w", "h", "most", "reason"),
    [
        (2, 2, 4, None),
        (3, 5, 15, None),
        (3, 5, 14, "image is 3x5 px = 15 pixels, at most 14 are allowed"),
        (1, 9, 99, "image is 1x9 px, a terrain needs at least 2x2"),
        (9, 1, 99, "image is 9x1 px, a terrain needs at least 2x2"),
    ],
)
def test_sizes_that_are_legal(w: int, h: int, most: int, reason: str | None) -> None:
    if reason is None:
        check_size(Path("a.png"), w, h, most)
        return
    with pytest.raises(SourceError, match=rf"a\.png: {reason}"):
        check_size(Path("a.png"), w, h, most)


def test_twenty_five_million_pixels_are_allowed_unless_said_otherwise(tmp_path: Path) -> None:
    for height, allowed in ((5000, True), (5001, False)):
        path = tmp_path / "a.pgm"
        path.write_bytes(b"P5 5000 %d 255\n" % height)
        with pytest.raises(
            SourceError, match="cannot be decoded" if allowed else "at most 25000000 are allowed"
        ):
            read_picture(path)


def test_transparency_is_kept_where_it_is_asked_for(tmp_path: Path) -> None:
    path = png(tmp_path, COLOR)
    np.testing.assert_array_equal(read_picture(path, alpha=True).pixels, COLOR)
    np.testing.assert_array_equal(read_picture(path).pixels, COLOR[..., :3])
    assert read_picture(path).tags == {}


def test_pages_and_bands_beyond_the_first_are_told(tmp_path: Path) -> None:
    pages = [Image.fromarray(COLOR[..., k]) for k in (0, 1)]
    path = tmp_path / "a.tif"
    pages[0].save(path, save_all=True, append_images=pages[1:])
    with pytest.warns(UserWarning, match=r"a\.tif: has 2 pages, the first is taken"):
        np.testing.assert_array_equal(read_picture(path).pixels, COLOR[..., 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pages[0].save(path)
        assert read_picture(path).tags[tiff.WIDTH] == (7,)
        Image.fromarray(COLOR[..., :3]).save(path)  # three bands that are colors
        assert read_picture(path).pixels.shape == (5, 7, 3)


@pytest.mark.parametrize(("bands", "told"), [(2, False), (3, True), (5, True)])
def test_bands_that_are_no_colors_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bands: int, told: bool
) -> None:
    """A decoder that takes the first band of several."""
    path = tmp_path / "a.tif"
    Image.fromarray(np.dstack([COLOR] * 2)[..., :3]).save(path)
    data = path.read_bytes()
    entry = np.array([tiff.SAMPLES, 3], "<u2").tobytes() + np.array([1, bands], "<u4").tobytes()
    at = data.index(entry[:8])
    path.write_bytes(data[:at] + entry + data[at + 12 :])
    monkeypatch.setattr(cv2, "imdecode", lambda *_: COLOR[..., 0])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_picture(path)
    expected = [f"{path}: has {bands} bands, the first is taken"] if told else []
    assert [str(w.message) for w in caught] == expected


def test_the_decoders_log_is_left_as_it_was(tmp_path: Path) -> None:
    log = cv2.utils.logging
    before = log.getLogLevel()
    try:
        log.setLogLevel(log.LOG_LEVEL_ERROR)
        read_picture(png(tmp_path, COLOR))
        assert log.getLogLevel() == log.LOG_LEVEL_ERROR
    finally:
        log.setLogLevel(before)


def test_a_jpeg_without_its_end_is_refused_in_our_words(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), np.random.default_rng(1).integers(0, 255, (64, 64), np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + b"\xff\xd9")
    with pytest.raises(SourceError, match=r"a\.jpg: is damaged: Corrupt JPEG data"):
        read_picture(path)
    assert capfd.readouterr().err == ""
