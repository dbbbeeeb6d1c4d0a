"""Pictures become height fields: what the file says is kept, what it lacks is the documented default."""

from __future__ import annotations

import struct
import tracemalloc
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
from lirs_wct.geometry.grid import resample
from lirs_wct.sources.build import build_world
from lirs_wct.sources.bundled import BundledPicture
from lirs_wct.sources.picture import apply_filters, read_terrain
from lirs_wct.sources.source import BuildOptions, find_source
from tests.kit import read_heights as read, refused

RAMP = np.arange(12, dtype=np.uint16).reshape(3, 4)


def png(path: Path, pixels: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), pixels)
    return path


def tiff(path: Path, pixels: np.ndarray, **tags: object) -> Path:
    """Write a GeoTIFF; `scale`, `tie`, `keys`, `nodata`."""
    numbers = {"scale": (33550, 12), "tie": (33922, 12), "keys": (34735, 3), "nodata": (42113, 2)}
    if "scale" in tags:
        tags = {"tie": (0.0, 0.0, 0.0, 5e5, 6e6, 0.0), **tags}
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


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int32", "float32"])
def test_every_depth_gives_the_same_terrain(tmp_path: Path, dtype: str) -> None:
    surface = read(tiff(tmp_path / "a.tif", RAMP.astype(dtype)))
    np.testing.assert_allclose(surface.z, RAMP / 11 * 6, atol=1e-6)


def test_nearly_gray_is_gray_and_color_needs_the_option(tmp_path: Path) -> None:
    color = np.repeat(np.linspace(0, 200, 12, dtype=np.uint8).reshape(3, 4, 1), 3, axis=2)
    gray = read(png(tmp_path / "gray.png", color)).z
    color[1, 1, 2] += 2
    assert np.abs(read(png(tmp_path / "near.png", color)).z - gray).max() < 0.03
    color[1, 1, 2] += 1
    path = png(tmp_path / "color.png", color)
    with pytest.raises(SourceError, match=r"color\.png: is in color.*--grayscale"):
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


@pytest.mark.parametrize("suffix", ["png", "jpg", "gif", "bmp", "tif", "pgm"])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.7, 0.97])
def test_truncated_files_are_refused(tmp_path: Path, suffix: str, share: float) -> None:
    pixels = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (65, 97), np.uint8), (0, 0), 3)
    whole, cut = tmp_path / f"whole.{suffix}", tmp_path / f"cut.{suffix}"
    Image.fromarray(pixels).save(whole)
    assert read(whole).shape == (65, 97)
    data = whole.read_bytes()
    cut.write_bytes(data[: int(len(data) * share)])
    with refused(f"{cut}: "):
        read(cut)


@pytest.mark.parametrize("size", [(100_000, 100_000), (1, 64)])
def test_the_size_is_judged_by_the_header(tmp_path: Path, size: tuple[int, int]) -> None:
    path, head = tmp_path / "a.png", b"\x89PNG\r\n\x1a\n"
    for body in (b"IHDR" + struct.pack(">IIBBBBB", *size, 8, 0, 0, 0, 0), b"IDAT"):
        head += struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    path.write_bytes(head)
    with pytest.raises(SourceError, match=f"image is {size[0]}x{size[1]} px"):
        read(path)


def test_missing_empty_and_folder(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    for name, reason in (("no.png", "No such file"), ("empty.png", "is empty"), ("", "Is a directory")):
        with pytest.raises(SourceError, match=reason):
            read(tmp_path / name)


def test_contradicting_options_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"--size, --resolution"):
        read(png(tmp_path / "a.png", RAMP), size=3.0, resolution=1.0)


def test_nothing_but_our_warnings_reaches_stderr(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "short.pgm").write_bytes(b"P5 9 9 255\nabc")
    keys = (1, 1, 0, 1, 1024, 0, 1, 1)
    with warnings.catch_warnings(action="error"):
        read(tiff(tmp_path / "a.tif", RAMP.astype(np.float32), scale=(1.0, 1.0, 0.0), keys=keys))
    with pytest.raises(SourceError):
        read(tmp_path / "short.pgm")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("tags", "options", "words"),
    [
        ({}, {}, "size 50 m on the longer side by default, height 6 m by default"),
        ({}, {"size": 20}, "size as given, height 6 m by default"),
        ({}, {"resolution": 0.5, "height": 2}, "as given"),
        ({"scale": (2.0, 2.0, 0.0)}, {}, "the file's own"),
        ({"scale": (2.0, 2.0, 0.0)}, {"size": 20}, "size as given, height the file's own"),
        ({"scale": (2.0, 2.0, 0.0)}, {"height": 2}, "size the file's own, height as given"),
    ],
)
def test_the_world_says_where_its_meters_come_from(
    tags: dict[str, Any], options: dict[str, Any], words: str, tmp_path: Path
) -> None:
    path = tiff(tmp_path / "a.tif", RAMP.astype(np.float32), **tags)
    assert build_world(path, BuildOptions(**options)).scale == words


# ---- numbers by hand


def test_a_crop_up_to_the_border_is_legal(tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).integers(0, 65535, (7, 9), np.uint16)
    path = png(tmp_path / "a.png", pixels)
    for crop in ((0, 0, 9, 7), (2, 3, 7, 4), (1, 0, 2, 2), (7, 5, 2, 2)):
        col, row, width, height = crop
        kept = pixels[row : row + height, col : col + width].astype(float)
        surface = read(path, crop=crop, height=float(np.ptp(kept)), resolution=0.5)
        assert surface.size == (0.5 * (width - 1), 0.5 * (height - 1))
        np.testing.assert_allclose(surface.z, kept - kept.min(), rtol=1e-6)
    for crop in ((1, 0, 9, 7), (0, 1, 9, 7), (8, 5, 2, 2), (7, 6, 2, 2)):
        with pytest.raises(SourceError, match=r"is 9x7 px, a crop of \dx\d at \d,\d is not within it"):
            read(path, crop=crop)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colors_become_gray_by_their_luma(tmp_path: Path, dtype: type[np.generic]) -> None:
    rgb = np.random.default_rng(2).integers(0, np.iinfo(dtype).max, (4, 6, 3)).astype(dtype)
    luma = rgb @ np.array((0.299, 0.587, 0.114))  # ITU-R BT.601
    surface = read(png(tmp_path / "a.png", rgb[..., ::-1]), grayscale=True, height=float(np.ptp(luma)))
    np.testing.assert_allclose(surface.z, luma - luma.min(), rtol=1e-4, atol=1e-3)


FOOT, SURVEY = 0.3048, 1200 / 3937


@pytest.mark.parametrize(
    ("options", "cell", "top"),
    [
        ({}, (2 * FOOT, 4 * FOOT), 5.5 * SURVEY),
        ({"scale": (2.0, 3.0, 5.0), "z_scale": 0.5, "height": 2.0}, (4 * FOOT, 12 * FOOT), 5.0),
        ({"size": 16.0}, (4.0, 8.0), 5.5 * SURVEY),  # the longer side, 2 x 4 feet, becomes 16 m
        pytest.param({"height": 3.0}, (2 * FOOT, 4 * FOOT), 3.0, marks=pytest.mark.slow),
        pytest.param({"z_scale": 4.0}, (2 * FOOT, 4 * FOOT), 22 * SURVEY, marks=pytest.mark.slow),
        pytest.param(
            {"scale": (2.0, 3.0, 5.0)}, (4 * FOOT, 12 * FOOT), 27.5 * SURVEY, marks=pytest.mark.slow
        ),
        pytest.param({"resolution": 0.25}, (0.25, 0.25), 5.5 * SURVEY, marks=pytest.mark.slow),
        pytest.param({"size": (9.0, 8.0)}, (3.0, 4.0), 5.5 * SURVEY, marks=pytest.mark.slow),
    ],
)
def test_every_unit_and_option_by_hand(
    tmp_path: Path, options: dict[str, Any], cell: tuple[float, float], top: float
) -> None:
    """A GeoTIFF of 3 x 4 nodes, 2 by 4 feet apart, heights in US survey feet."""
    keys = (1, 1, 0, 2, 3076, 0, 1, 9002, 4099, 0, 1, 9003)
    heights = (7 + 0.5 * RAMP).astype(np.float32)
    surface = read(tiff(tmp_path / "a.tif", heights, scale=(2.0, 4.0, 0.0), keys=keys), **options)
    assert surface.cell == pytest.approx(cell, rel=1e-6)
    np.testing.assert_allclose(surface.z, RAMP / 11 * top, rtol=1e-5, atol=1e-6)
    assert surface.origin == pytest.approx((-1.5 * cell[0], -cell[1]), rel=1e-6)
    assert surface.z.dtype == np.float32


def test_inverted_and_flat_heights_start_at_zero(tmp_path: Path) -> None:
    path = tiff(tmp_path / "a.tif", (100 + RAMP).astype(np.float32), scale=(1.0, 1.0, 0.0))
    np.testing.assert_array_equal(read(path, invert=True).z, 11 - RAMP.astype(np.float32))
    flat = tiff(tmp_path / "b.tif", np.full((3, 4), 55, np.float32), scale=(1.0, 1.0, 0.0))
    assert not read(flat).z.any()
    assert not read(flat, height=3.0).z.any()


def test_large_levels_keep_their_differences(tmp_path: Path) -> None:
    """Of 32-bit integers and doubles float32 would lose the last digits before the lowest is taken off."""
    levels = RAMP.astype(np.int64) + 2**28
    for dtype in (np.int32, np.float64):
        path = tmp_path / "a.tif"
        cv2.imwrite(str(path), levels.astype(dtype))
        np.testing.assert_allclose(read(path, height=11.0).z, RAMP, atol=1e-5)


@pytest.mark.parametrize(
    "value", [-9999.0, -32768.0, -2e30, -3.4028235e38, 3.4e38, 1234.5, np.inf, -np.inf, np.nan]
)
def test_each_hole_takes_its_nearest_height(tmp_path: Path, value: float) -> None:
    tags = {"nodata": str(value)} if value == 1234.5 else {}
    heights = np.array([[1, 2, 3, 4, 5], [6, 7, 8, 9, 10], [11, 12, 13, 14, 20]], np.float32)
    holed = heights.copy()
    holed[0, 0], holed[1, 4] = value, value
    with pytest.warns(UserWarning, match="2 of 15 pixels have no height"):
        z = read(tiff(tmp_path / "a.tif", holed, scale=(1.0, 1.0, 0.0), **tags)).z
    lowest = z[0, 0] + 0.0
    assert lowest in (2 - 2, 6 - 2)  # the neighbor east or south
    assert z[1, 4] in (5 - 2, 9 - 2, 20 - 2)
    assert (z[2, 4], z[0, 3]) == (18, 2)


def test_half_of_the_pixels_may_lack_a_height(tmp_path: Path) -> None:
    heights = np.arange(16, dtype=np.float32).reshape(4, 4)
    heights[:2] = np.nan
    with pytest.warns(UserWarning, match="8 of 16"):
        assert read(tiff(tmp_path / "a.tif", heights, scale=(1.0, 1.0, 0.0))).z.max() == 7
    heights[2, 0] = np.nan
    with pytest.raises(SourceError, match=r"9 of 16 pixels have no height.*at most half"):
        read(tiff(tmp_path / "b.tif", heights))


def test_unsigned_levels_are_never_nodata_unless_the_file_says_so(tmp_path: Path) -> None:
    levels = np.arange(16, dtype=np.uint16).reshape(4, 4)
    with warnings.catch_warnings(action="error"):
        assert read(tiff(tmp_path / "a.tif", levels), height=15.0).z.max() == 15
    with pytest.warns(UserWarning, match="1 of 16"):
        z = read(tiff(tmp_path / "b.tif", levels, nodata="15"), height=14.0).z
    assert z[3, 3] in (11, 14)


def test_heights_just_above_nodata_are_heights(tmp_path: Path) -> None:
    heights = np.array([[-9998.0, 0.0], [-9990.0, 9.0e6]], np.float32)
    with warnings.catch_warnings(action="error"):
        assert read(tiff(tmp_path / "a.tif", heights, scale=(1.0, 1.0, 0.0))).z.max() == 9_009_998


@pytest.mark.parametrize(
    ("options", "size", "height", "words"),
    [
        ({}, (50.0, 25.0), 1.25, "as bundled"),
        ({"size": 20.0}, (20.0, 10.0), 1.25, "as given"),
        ({"height": 2.5}, (50.0, 25.0), 2.5, "as given"),
        ({"resolution": 0.25}, (1.0, 0.5), 1.25, "as given"),
    ],
)
def test_a_bundled_world_has_meters_of_its_own(
    options: dict[str, Any],
    size: tuple[float, float],
    height: float,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pixels = np.arange(15, dtype=np.uint16).reshape(3, 5)
    small = BundledPicture(pixels=pixels, height=1.25, hills=np.zeros((3, 5)))
    monkeypatch.setattr("lirs_wct.sources.picture.bundled_picture", lambda _: small)
    given = BuildOptions(**options)
    ground, scale, _ = read_terrain(find_source("simple", given), given)
    assert ground.surface.size == pytest.approx(size)
    np.testing.assert_allclose(ground.surface.z, small.pixels / 14 * height, atol=1e-6)
    assert scale == words


def test_a_window_keeps_the_meters_of_the_whole(tmp_path: Path) -> None:
    path = png(tmp_path / "a.png", np.random.default_rng(0).integers(0, 99, (41, 81), np.uint8))
    given = BuildOptions(resolution=0.5, height=4.0, window=(3.0, -1.0, 10.0))
    ground, _, place = read_terrain(find_source(path, given), given)
    assert place is None
    assert ground.surface.bounds == (-2.0, -6.0, 8.0, 4.0)
    whole = read(path, resolution=0.5, height=4.0)
    assert whole.bounds == (-20.0, -10.0, 20.0, 10.0)
    kept = whole.z[12:33, 36:57]
    np.testing.assert_array_equal(ground.surface.z, kept - kept.min())


def test_deterrace_needs_levels(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="floating-point heights, --option deterrace=true needs"):
        read(tiff(tmp_path / "c.tif", RAMP.astype(np.float32)), deterrace=True)


def test_smoothed_heights_start_at_zero_too(tmp_path: Path) -> None:
    """A smoothed pit is less deep: its bottom is the lowest point all the same."""
    heights = np.full((21, 25), 40, np.float32)
    heights[10, 12] = 0.0
    path = tiff(tmp_path / "a.tif", heights, scale=(1.0, 1.0, 0.0))
    z = read(path, smoothing=1).z
    assert z.min() == z[10, 12] == 0.0
    assert 0 < z.max() < 40


def test_a_large_picture_stands_in_memory_twice_at_most(tmp_path: Path) -> None:
    """As gray levels and as heights: 6 bytes a pixel of 16 bits, 10 with one more copy of the heights."""
    side = 2000
    levels = np.random.default_rng(4).integers(0, 1 << 16, (side, side)).astype(np.uint16)
    path = tmp_path / "large.png"
    cv2.imwrite(str(path), levels)
    read(path)
    tracemalloc.start()
    read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 9 * side**2


def test_bands_of_floats_are_no_colors(tmp_path: Path) -> None:
    bands = np.random.default_rng(6).random((9, 8, 3)).astype(np.float32) * 700
    wrong = png(tmp_path / "bands.tif", bands)
    expected = r"bands\.tif: has 3 different bands of float32, a terrain needs one band .*-b 1.*--grayscale"
    with pytest.raises(SourceError, match=expected):
        read(wrong)
    assert read(wrong, grayscale=True).shape == (9, 8)
    assert read(png(tmp_path / "same.tif", np.repeat(bands[..., :1], 3, axis=2))).shape == (9, 8)


SLOPE = np.tile(np.arange(40, dtype=np.float32), (30, 1))


def noise(rows: int = 60, cols: int = 80) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 65535, (rows, cols), np.uint16)


def filtered(values: np.ndarray, **options: Any) -> np.ndarray:
    return apply_filters(values, BuildOptions(**options))


def test_median_takes_single_wrong_pixels_away() -> None:
    holed = SLOPE.copy()
    holed[10, 10] = 500
    np.testing.assert_allclose(filtered(holed, denoise="median")[3:-3, 3:-3], SLOPE[3:-3, 3:-3], atol=1)


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
    np.testing.assert_allclose(filtered(SLOPE, sharpness=2.0)[:, 9:-9], SLOPE[:, 9:-9], atol=1e-4)


PLANE = SLOPE + np.arange(30, dtype=np.float32)[:, None]


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
    surface = read(png(tmp_path / "a.png", noise()), resolution=0.5, resize=(20, 30))
    assert surface.shape == (30, 20)
    assert surface.size == pytest.approx((79 * 0.5, 59 * 0.5))
    assert surface.relief == pytest.approx(6)


def test_deterrace_knows_8_bits_stored_as_16(tmp_path: Path) -> None:
    levels = np.tile((np.arange(200) // 20), (50, 1)).astype(np.uint16)
    first, *others = (
        read(png(tmp_path / "a.png", levels * factor), deterrace=True, height=9.0).z
        for factor in (1, 257, 256)
    )
    # Ten stairs of one level become a ramp: no step is left of more than a tenth of a level.
    assert np.abs(np.diff(first[25])).max() < 0.1 * 1.2
    for z in others:
        np.testing.assert_allclose(z, first, atol=1e-4)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_error": 0.1, "max_triangles": 100}, "max-error, max-triangles"),
        ({"denoise": "magic"}, "denoise must be median or bilateral, got 'magic'"),
        ({"crop": (-1, 0, 5, 5)}, "crop needs"),
        ({"resize": (1, 5)}, "resize needs"),
        ({"smoothing": 0.0}, "smoothing must be"),
        ({"scale": (1.0, -1.0, 1.0)}, "scale must be"),
        ({"rotate_x": float("nan")}, "rotate x must be finite"),
    ],
)
def test_illegal_options_are_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        BuildOptions(**options)  # type: ignore[arg-type]
