"""Suggestion to read a picture as a laser map."""

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_wct.sources.build import build_world
from lirs_wct.sources.options import BuildOptions
from lirs_wct.sources.pictures.picture import looks_like_map

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
    with pytest.warns(UserWarning, match="give its YAML file, or --as map with --resolution"):
        build_world(tmp_path / "room.png")


def test_a_picture_that_is_declared_one_is_not_suggested_as_a_map(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "room.png"), ROOM)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build_world(tmp_path / "room.png", BuildOptions(kind="picture"))


@pytest.mark.parametrize("bits", [np.uint16, np.float32])
def test_pictures_of_more_bits_are_terrains(bits: type) -> None:
    assert looks_like_map(ROOM)
    assert not looks_like_map(ROOM.astype(bits))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "expected"),
    [*((f"maps/{m}", True) for m in MAPS), *((f"height/{t}", False) for t in TERRAINS)],
)
def test_real_pictures(shared_data: Path, name: str, expected: bool) -> None:
    picture = cv2.imread(str(shared_data / name), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    gray = picture if picture.ndim == 2 else picture[..., 0]
    assert looks_like_map(gray) == expected
