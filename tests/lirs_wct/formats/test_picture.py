"""Decoded pictures: sizes that are legal, warnings, depth, and damage."""

import struct
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from PIL import Image

from lirs_wct.errors import SourceError
from lirs_wct.formats.picture import read_picture

COLOR = np.random.default_rng(4).integers(0, 255, (5, 7, 4), np.uint8)


def png(folder: Path, pixels: np.ndarray) -> Path:
    assert cv2.imwrite(str(folder / "a.png"), pixels)
    return folder / "a.png"


def test_twenty_five_million_pixels_are_allowed_unless_said_otherwise(tmp_path: Path) -> None:
    for height, allowed in ((5000, True), (5001, False)):
        path = tmp_path / "a.pgm"
        path.write_bytes(b"P5 5000 %d 255\n" % height)
        with pytest.raises(
            SourceError, match="is damaged: " if allowed else r"at most 25000000 are .* up to 5\.5 GB"
        ):
            read_picture(path)


def test_transparency_is_kept_where_it_is_asked_for(tmp_path: Path) -> None:
    path = png(tmp_path, COLOR)
    np.testing.assert_array_equal(read_picture(path, alpha=True).pixels, COLOR)
    with pytest.warns(UserWarning, match=r"a\.png: 35 of 35 pixels are transparent; the alpha channel"):
        np.testing.assert_array_equal(read_picture(path).pixels, COLOR[..., :3])


def test_pages_and_bands_beyond_the_first_are_told(tmp_path: Path) -> None:
    pages = [Image.fromarray(COLOR[..., k]) for k in (0, 1)]
    path = tmp_path / "a.tif"
    pages[0].save(path, save_all=True, append_images=pages[1:])
    with pytest.warns(UserWarning, match=r"a\.tif: has 2 pages, the first is taken"):
        np.testing.assert_array_equal(read_picture(path).pixels, COLOR[..., 0])
    with warnings.catch_warnings(action="error"):
        pages[0].save(path)
        np.testing.assert_array_equal(read_picture(path).pixels, COLOR[..., 0])
        Image.fromarray(COLOR[..., :3]).save(path)  # three bands that are colors
        assert read_picture(path).pixels.shape == (5, 7, 3)


@pytest.mark.parametrize(("bands", "told"), [(1, False), (2, True), (5, True)])
def test_bands_that_are_no_colors_are_told(tmp_path: Path, bands: int, told: bool) -> None:
    path = tmp_path / "a.tif"
    shape = {"width": 7, "height": 5, "count": bands, "dtype": "int16", "photometric": "MINISBLACK"}
    with rasterio.open(path, "w", driver="GTiff", **shape) as file:
        file.write(np.stack([COLOR[..., 0].astype(np.int16) + k for k in range(bands)]))
    with warnings.catch_warnings(record=True, action="always") as caught:
        np.testing.assert_array_equal(read_picture(path).pixels, COLOR[..., 0])
    expected = [f"{path}: has {bands} bands, the first is taken"] if told else []
    assert [str(w.message) for w in caught] == expected


@pytest.mark.parametrize("maximum", [1, 100, 160, 254, 255, 256, 1023, 65535])
@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("bands", [1, 3])
def test_a_pnm_keeps_its_values_and_states_its_white(
    tmp_path: Path, maximum: int, plain: bool, bands: int
) -> None:
    values = np.random.default_rng(maximum).integers(0, maximum + 1, (6, 5, bands)).squeeze()
    kind = ">u2" if maximum > 255 else "u1"
    body = " ".join(map(str, values.ravel())).encode() if plain else values.astype(kind).tobytes()
    path = tmp_path / "a.pgm"
    magic = (2 if plain else 5) + bands // 3
    path.write_bytes(b"P%d\n# a comment\n5 6 %d\n" % (magic, maximum) + body)
    found = read_picture(path)
    rounding = maximum / 510 if magic == 3 and maximum > 255 else 0  # Pillow keeps 8 bits
    np.testing.assert_allclose(
        found.pixels, values[..., ::-1] if bands > 1 else values, atol=rounding + 0.5 * (rounding > 0)
    )
    assert found.full == maximum
    path.write_bytes(path.read_bytes()[:-2])
    if not plain:
        with pytest.raises(SourceError, match=r"a\.pgm: is damaged"):
            read_picture(path)


@pytest.mark.parametrize(("kind", "clear"), [(0, (770,)), (2, (300, 400, 500))])
def test_a_clear_color_of_16_bits(tmp_path: Path, kind: int, clear: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(2).integers(0, 65536, (3, 4, len(clear))).astype(">u2")
    pixels[1, 2] = clear
    pixels[2, 1, -1:], pixels[2, 1, :-1] = clear[-1] + 1, clear[:-1]
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", 4, 3, 16, kind, 0, 0, 0)),
        (b"tRNS", np.array(clear, ">u2").tobytes()),
        (b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in pixels))),
        (b"IEND", b""),
    )
    chunks = [struct.pack(">I", len(b)) + t + b + struct.pack(">I", zlib.crc32(t + b)) for t, b in parts]
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    found = read_picture(tmp_path / "a.png", alpha=True).pixels
    np.testing.assert_array_equal(found[..., 2::-1], np.broadcast_to(pixels, (3, 4, 3)))
    assert np.argwhere(found[..., 3] != 65535).tolist() == [[1, 2]]
    assert found[1, 2, 3] == 0


def test_kinds_of_tiff(tmp_path: Path) -> None:
    """A palette, colors with alpha, and white as zero."""
    path = tmp_path / "a.tif"
    Image.fromarray(COLOR[..., :3]).quantize(8).save(path)
    expected = np.asarray(Image.open(path).convert("RGB"))[..., ::-1]
    np.testing.assert_array_equal(read_picture(path).pixels, expected)
    Image.fromarray(COLOR).save(path)
    np.testing.assert_array_equal(read_picture(path, alpha=True).pixels, COLOR[..., [2, 1, 0, 3]])
    with rasterio.open(
        path, "w", driver="GTiff", width=7, height=5, count=1, dtype="uint8", photometric="MINISWHITE"
    ) as file:
        file.write(COLOR[..., 0], 1)
    np.testing.assert_array_equal(read_picture(path).pixels, 255 - COLOR[..., 0])


def test_pictures_beyond_the_limit_of_pillow_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 17)
    path = png(tmp_path, COLOR[..., 0])
    np.testing.assert_array_equal(read_picture(path).pixels, COLOR[..., 0])
    with pytest.raises(SourceError, match="image is 7x5 px = 35 pixels, at most 34 are allowed"):
        read_picture(path, 34)


def test_a_jpeg_without_its_end_is_refused_in_our_words(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), np.random.default_rng(1).integers(0, 255, (64, 64), np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + b"\xff\xd9")
    with pytest.raises(SourceError, match=r"a\.jpg: .*Corrupt JPEG data"):
        read_picture(path)
    assert capfd.readouterr().err == ""
