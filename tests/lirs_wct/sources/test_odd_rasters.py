"""Odd inputs: each works, or is refused in one line."""

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField
from lirs_wct.meshing.simplify import triangulate
from lirs_wct.sources.build import build_world
from lirs_wct.sources.picture import dequantize, looks_like_map, warn_nodata_border
from lirs_wct.sources.source import BuildOptions
from tests.kit import read_heights

HEADER = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n"


def test_a_byte_order_mark_is_no_part_of_the_header(tmp_path: Path) -> None:
    path = tmp_path / "mark.asc"
    path.write_text(HEADER + "1 2 3\n4 5 6\n", encoding="utf-8-sig")
    assert build_world(path).surface.relief == 5


def test_a_name_too_long_for_files_is_refused() -> None:
    with pytest.raises(ConfigError, match="--name: a world's name has at most 200 characters, got 300"):
        build_world("simple", BuildOptions(name="a" * 300))


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
    with warnings.catch_warnings(record=True, action="always") as told:
        surface = read_heights(path)
    (line,) = (str(each.message) for each in told)
    assert line.startswith(f"{path}: 261 pixels of 0 along the border stand beside heights 30")
    assert line.endswith("say --option nodata=0")
    assert surface.relief > 2900
    with pytest.warns(UserWarning, match=r"a\.asc: 261 of 2000 pixels have no height"):
        assert read_heights(path, nodata=0.0).relief < 150


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
    with warnings.catch_warnings(action="error"):
        read_heights(asc(tmp_path / "a.asc", heights))


def test_zeros_inside_or_declared_are_no_question() -> None:
    hole = HILLS.copy()
    hole[10:20, 10:20] = 0.0
    with warnings.catch_warnings(action="error"):
        warn_nodata_border(Path("a.asc"), hole, 1.0)
        warn_nodata_border(Path("a.asc"), np.zeros((5, 5)), 1.0)
    with pytest.warns(UserWarning, match="pixels of 0 along the border"):
        warn_nodata_border(Path("a.asc"), framed(1), 1.0)


def hills(n: int = 257) -> np.ndarray:
    """(n, n) float32 0 to 255, smooth."""
    z = cv2.GaussianBlur(np.random.default_rng(7).standard_normal((n, n)).astype(np.float32), (0, 0), n / 16)
    return (z - z.min()) / np.ptp(z) * 255


@pytest.mark.parametrize("step", [1.0, 257.0])
def test_within_half_a_level_and_close_to_what_was_cut(step: float) -> None:
    true = hills()
    levels = np.round(true)
    smooth = dequantize(levels * np.float32(step), step) / step
    assert np.abs(smooth - levels).max() <= 0.5 + 1e-4
    before, after = ((a - true).std() for a in (levels, smooth))
    assert after < before / 3


def test_few_triangles_again() -> None:
    true = hills(513)
    levels = np.round(true)

    def triangles(z: np.ndarray) -> int:
        surface = HeightField.centered((z / 255).astype(np.float32), (1, 1))
        return len(triangulate(surface, max_error=5e-4)[1])

    exact, stairs, smooth = triangles(true), triangles(levels), triangles(dequantize(levels))
    assert stairs > 4 * exact
    assert smooth <= 1.5 * exact


def test_steps_higher_than_a_level_stay() -> None:
    levels = np.zeros((40, 40), np.float32)
    levels[:, 20:] = 100
    smooth = dequantize(levels)
    assert np.abs(smooth - levels).max() <= 0.5
    assert (smooth[:, 20] - smooth[:, 19]).min() >= 99


def test_level_ground_stays() -> None:
    np.testing.assert_array_equal(dequantize(np.full((7, 5), 3, np.float32)), np.full((7, 5), 3))


@pytest.mark.parametrize("shape", [(2, 2), (2, 900), (37, 16)])
def test_any_shape(shape: tuple[int, int]) -> None:
    levels = np.random.default_rng(0).integers(0, 255, shape).astype(np.float32)
    assert np.abs(dequantize(levels) - levels).max() <= 0.5


MAPS = (
    "f1tenth_racetracks/Austin_map.png",
    "mir_robot/maze.png",
    "navigation2/depot.pgm",
    "navigation_tutorials/willow-full.pgm",
    "turtlebot3/map.pgm",
)
TERRAINS = ("PX4-SITL_gazebo-classic__terrain.png", "mujoco__hfield_240_280.png", "vrc_driving_heightmap.png")

ROOM = np.full((40, 40), 205, np.uint8)
ROOM[5:35, 5:35] = 254
ROOM[5, 5:35] = 0


def test_a_map_without_its_yaml_is_suggested(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "room.png"), ROOM)
    with pytest.warns(UserWarning, match="give its YAML file, or --kind map with --resolution"):
        build_world(tmp_path / "room.png")


def test_a_picture_that_is_declared_one_is_not_suggested_as_a_map(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "room.png"), ROOM)
    with warnings.catch_warnings(action="error"):
        build_world(tmp_path / "room.png", BuildOptions(kind="picture"))


@pytest.mark.parametrize("bits", [np.uint16, np.float32])
def test_pictures_of_more_bits_are_terrains(bits: type) -> None:
    assert looks_like_map(ROOM)
    assert not looks_like_map(ROOM.astype(bits))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "expected"), [*((f"maps/{m}", True) for m in MAPS), *((f"height/{t}", False) for t in TERRAINS)]
)
def test_real_pictures(shared_data: Path, name: str, expected: bool) -> None:
    picture = cv2.imread(str(shared_data / name), cv2.IMREAD_UNCHANGED)
    gray = picture if picture.ndim == 2 else picture[..., 0]
    assert looks_like_map(gray) == expected
