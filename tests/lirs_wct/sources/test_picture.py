"""Pictures become height fields: what the file says is kept, what it lacks is the documented default."""

from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.sources.options import BuildOptions
from lirs_wct.sources.picture import read_height_field
from lirs_wct.world import build_world

RAMP = np.arange(12, dtype=np.uint16).reshape(3, 4)


def read(path: Path, **options: object) -> HeightField:
    return read_height_field(path, BuildOptions(**options))  # type: ignore[arg-type]


def png(path: Path, pixels: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), pixels)
    return path


def tiff(path: Path, pixels: np.ndarray, **tags: object) -> Path:
    """Write a GeoTIFF; `scale`, `tie`, `keys`, `nodata`."""
    numbers = {"scale": (33550, 12), "tie": (33922, 12), "keys": (34735, 3), "nodata": (42113, 2)}
    info = ImageFileDirectory_v2()
    for name, value in tags.items():
        number, kind = numbers[name]
        info.tagtype[number] = kind
        info[number] = value
    Image.fromarray(pixels).save(path, tiffinfo=info)
    return path


def test_defaults_of_a_picture_without_scale(tmp_path: Path) -> None:
    surface = read(png(tmp_path / "a.png", RAMP))
    assert surface.size == pytest.approx((50, 100 / 3))
    assert (surface.z.min(), surface.z.max()) == (0, 6)
    assert surface.bounds == pytest.approx((-25, -50 / 3, 25, 50 / 3))
    np.testing.assert_allclose(surface.z, RAMP / 11 * 6, atol=1e-6)


def test_the_top_row_is_north(tmp_path: Path) -> None:
    pixels = np.zeros((5, 5), np.uint8)
    pixels[0] = 255
    surface = read(png(tmp_path / "a.png", pixels))
    assert surface.height_at(0, 25) == 6
    assert surface.height_at(0, -25) == 0


@pytest.mark.parametrize(
    ("options", "size", "relief"),
    [
        ({"size": 9.0}, (9, 6), 6),
        ({"size": (5.0, 7.0), "height": 2.0}, (5, 7), 2),
        ({"pixel_size": 0.5}, (1.5, 1.0), 6),
    ],
)
def test_size_and_height(tmp_path: Path, options: dict[str, object], size: object, relief: float) -> None:
    surface = read(png(tmp_path / "a.png", RAMP), **options)
    assert surface.size == pytest.approx(size)
    assert surface.z.max() == pytest.approx(relief)


def test_invert(tmp_path: Path) -> None:
    surface = read(png(tmp_path / "a.png", RAMP), invert=True)
    np.testing.assert_allclose(surface.z, 6 - RAMP / 11 * 6, atol=1e-6)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int32", "float32"])
def test_every_depth_gives_the_same_terrain(tmp_path: Path, dtype: str) -> None:
    surface = read(tiff(tmp_path / "a.tif", RAMP.astype(dtype)))
    np.testing.assert_allclose(surface.z, RAMP / 11 * 6, atol=1e-6)


def test_16_bits_survive(tmp_path: Path) -> None:
    levels = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    z = read(png(tmp_path / "a.png", levels), height=65535.0).z
    np.testing.assert_array_equal(z, levels.astype(np.float32))


def test_nearly_gray_is_gray_and_colour_needs_the_option(tmp_path: Path) -> None:
    colour = np.repeat(np.linspace(0, 200, 12, dtype=np.uint8).reshape(3, 4, 1), 3, axis=2)
    gray = read(png(tmp_path / "gray.png", colour)).z
    colour[1, 1, 2] += 2
    assert np.abs(read(png(tmp_path / "near.png", colour)).z - gray).max() < 0.03
    colour[1, 1, 2] += 1
    path = png(tmp_path / "colour.png", colour)
    with pytest.raises(SourceError, match=r"colour\.png: is in colour.*--grayscale"):
        read(path)
    assert read(path, grayscale=True).relief == pytest.approx(6)


def test_16_bit_gray_with_alpha(tmp_path: Path) -> None:
    bgra = np.dstack([RAMP] * 3 + [RAMP[::-1] * 5000])
    np.testing.assert_allclose(read(png(tmp_path / "a.png", bgra)).z, RAMP / 11 * 6, atol=1e-6)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_exif_orientation_is_applied(tmp_path: Path, suffix: str) -> None:
    turned = Image.Exif()
    turned[0x0112] = 6
    pixels = np.zeros((16, 32), np.uint8)
    pixels[:, 16:] = 255
    Image.fromarray(pixels).save(tmp_path / f"a.{suffix}", exif=turned)
    surface = read(tmp_path / f"a.{suffix}")
    assert surface.shape == (32, 16)
    assert surface.z[0].max() < 1 < 5 < surface.z[-1].min()


def test_pages_first_and_said(tmp_path: Path) -> None:
    pages = [Image.fromarray((RAMP * k).astype(np.uint8)) for k in (1, 3)]
    pages[0].save(tmp_path / "a.tif", save_all=True, append_images=pages[1:])
    with pytest.warns(UserWarning, match=r"a\.tif: has 2 pages, the first is taken"):
        z = read(tmp_path / "a.tif", height=11.0).z
    np.testing.assert_allclose(z, RAMP, atol=1e-5)


def test_flat_stays_flat(tmp_path: Path) -> None:
    assert not read(png(tmp_path / "a.png", np.full((4, 4), 77, np.uint8))).z.any()


@pytest.mark.parametrize("hole", [np.nan, -9999, -32768, -3.4028235e38, 1234.5])
def test_holes_are_filled_and_counted(tmp_path: Path, hole: float) -> None:
    heights = np.outer(np.arange(10), np.ones(9)).astype(np.float32)
    holed = heights.copy()
    holed[4, 3:6] = hole
    tags = {"nodata": str(hole)} if hole == 1234.5 else {}
    with pytest.warns(UserWarning, match="3 of 90 pixels have no height"):
        z = read(tiff(tmp_path / "a.tif", holed, **tags), height=9.0).z
    assert np.abs(z - heights).max() <= 1.0 + 1e-6
    holed[:6] = hole
    with pytest.raises(SourceError, match=r"54 of 90 pixels have no height.*at most half"):
        read(tiff(tmp_path / "b.tif", holed, **tags))


def test_geotiff_in_metres_is_read_as_it_is(tmp_path: Path) -> None:
    heights = (100 + 3 * RAMP).astype(np.float32)
    path = tiff(tmp_path / "a.tif", heights, scale=(2.0, 4.0, 0.0), tie=(0.0, 0, 0, 5e5, 6e6, 0))
    surface = read(path)
    assert surface.cell == (2, 4)
    np.testing.assert_array_equal(surface.z, heights - 100)
    assert read(path, height=1.0).z.max() == 1
    assert read(path, height=1.0).cell == (2, 4)
    assert read(path, size=12.0).cell == pytest.approx((3, 6))
    assert read(path, size=12.0).z.max() == 33


def test_geotiff_in_degrees_uses_the_latitude_of_its_centre(tmp_path: Path) -> None:
    keys = (1, 1, 0, 1, 1024, 0, 1, 2)
    tie = (0.0, 0.0, 0.0, 10.0, 60.0 + 1.5 / 3600, 0.0)
    path = tiff(
        tmp_path / "a.tif", RAMP.astype(np.float32), scale=(1 / 3600, 1 / 3600, 0.0), tie=tie, keys=keys
    )
    # One degree at 60 N on WGS 84: 55,800 m eastward, 111,412 m northward.
    assert read(path).cell == pytest.approx((55800 / 3600, 111412 / 3600), rel=1e-4)


def test_geotiff_in_feet(tmp_path: Path) -> None:
    keys = (1, 1, 0, 3, 1024, 0, 1, 1, 3076, 0, 1, 9002, 4099, 0, 1, 9002)
    path = tiff(tmp_path / "a.tif", RAMP.astype(np.float32), scale=(10.0, 10.0, 0.0), keys=keys)
    surface = read(path)
    assert surface.cell == pytest.approx((3.048, 3.048))
    assert surface.z.max() == pytest.approx(11 * 0.3048)


@pytest.mark.parametrize("suffix", ["png", "jpg", "gif", "bmp", "tif", "pgm"])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.7, 0.97])
def test_truncated_files_are_refused(tmp_path: Path, suffix: str, share: float) -> None:
    pixels = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (65, 97), np.uint8), (0, 0), 3)
    whole, cut = tmp_path / f"whole.{suffix}", tmp_path / f"cut.{suffix}"
    Image.fromarray(pixels).save(whole)
    assert read(whole).shape == (65, 97)
    data = whole.read_bytes()
    cut.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(SourceError) as refused:
        read(cut)
    message = str(refused.value)
    assert message.startswith(f"{cut}: ")
    assert "\n" not in message


def test_a_wrong_checksum_is_refused(tmp_path: Path) -> None:
    data = bytearray(png(tmp_path / "a.png", RAMP).read_bytes())
    data[50] ^= 1
    (tmp_path / "b.png").write_bytes(data)
    with pytest.raises(SourceError, match=r"b\.png: is damaged: checksum of PNG chunk IDAT is wrong"):
        read(tmp_path / "b.png")


@pytest.mark.parametrize("size", [(100_000, 100_000), (0, 10), (1, 64)])
def test_the_size_is_judged_by_the_header(tmp_path: Path, size: tuple[int, int]) -> None:
    body = b"IHDR" + struct.pack(">IIBBBBB", *size, 8, 0, 0, 0, 0)
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))
    path = tmp_path / "a.png"
    path.write_bytes(head)
    with pytest.raises(SourceError, match=f"image is {size[0]}x{size[1]} px"):
        read(path)


def test_max_pixels(tmp_path: Path) -> None:
    path = png(tmp_path / "a.png", RAMP)
    with pytest.raises(SourceError, match="image is 4x3 px = 12 pixels, at most 11 are allowed"):
        read(path, max_pixels=11)
    assert read(path, max_pixels=12).shape == (3, 4)


def test_missing_empty_and_folder(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    for name, reason in (("no.png", "No such file"), ("empty.png", "is empty"), ("", "Is a directory")):
        with pytest.raises(SourceError, match=reason):
            read(tmp_path / name)


def test_contradicting_options_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"--size, --pixel-size"):
        BuildOptions(size=3.0, pixel_size=1.0)


def test_nothing_but_our_warnings_reaches_stderr(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "short.pgm").write_bytes(b"P5 9 9 255\nabc")
    keys = (1, 1, 0, 1, 1024, 0, 1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(tiff(tmp_path / "a.tif", RAMP.astype(np.float32), scale=(1.0, 1.0, 0.0), keys=keys))
    with pytest.raises(SourceError):
        read(tmp_path / "short.pgm")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "size 50 m on the longer side by default, height 6 m by default"),
        ({"size": 20}, "size as given, height 6 m by default"),
        ({"pixel_size": 0.5, "height": 2}, "as given"),
    ],
)
def test_the_world_says_where_its_metres_come_from(
    options: dict[str, Any], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.arange(12, dtype=np.uint8).reshape(3, 4))
    assert build_world(path, BuildOptions(**options)).scale == words
