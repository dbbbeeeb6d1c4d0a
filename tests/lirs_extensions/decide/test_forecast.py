"""Forecast: information of scans, features of sites, and the stored models."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_extensions.decide.forecast import (
    MIN_INFORMATION,
    DriveSite,
    LogisticModel,
    changes,
    cloud_information,
    forecast,
    scan_information,
)
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import build_scenario
from lirs_wct import BuildOptions, World
from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import HeightField
from lirs_wct.ground import Terrain

NOTHING = math.log10(MIN_INFORMATION)
CONFIG = RunConfig(source="simple", mapper="hector", seconds=30)
ANGLES = np.radians(np.arange(-180.0, 180.0, 0.5))


def room(half_x: float, half_y: float) -> FloatArray:
    """Return (720, 2) hits in an empty room around the sensor."""
    with np.errstate(divide="ignore"):
        ranges = np.minimum(half_x / np.abs(np.cos(ANGLES)), half_y / np.abs(np.sin(ANGLES)))
    return np.column_stack((ranges * np.cos(ANGLES), ranges * np.sin(ANGLES)))


def cloud_of(lidar: str, ranges_of: object) -> FloatArray:
    """Return a lidar's (rings, columns, 3) end points in the horizontal plane's frame."""
    preset = make_lidar_preset(lidar)
    directions = preset.all_directions.reshape(preset.rings, preset.beams, 3)[:, ::10]
    return directions * ranges_of(directions)[..., None]  # type: ignore[operator]


def test_each_wall_of_a_square_room_informs_on_its_normal() -> None:
    points = room(3.0, 3.0)
    position, yaw = scan_information(points, len(points))
    assert 10**position == pytest.approx(0.5, abs=0.01)
    # The mean square of the arm, y of a wall's hits with x = 3: mean of 9 tan^2 over 45 deg.
    assert 10**yaw == pytest.approx(9 * (4 / math.pi - 1), rel=0.02)


def test_a_corridor_does_not_inform_along_itself() -> None:
    points = room(100.0, 1.5)
    near = points[np.hypot(*points.T) < 20]
    assert scan_information(near, len(points))[0] == NOTHING
    assert scan_information(room(6.0, 1.5), len(points))[0] > NOTHING + 1


def test_flat_ground_does_not_inform_a_cloud_on_the_plane_and_a_round_wall_does() -> None:
    def ground(directions: FloatArray) -> FloatArray:
        down = directions[..., 2]
        return np.where(down < -0.05, 1.0 / np.maximum(-down, 0.05), np.nan)

    def wall(directions: FloatArray) -> FloatArray:
        return 3.0 / np.hypot(directions[..., 0], directions[..., 1])

    assert cloud_information(cloud_of("vlp16", ground)) == (NOTHING, NOTHING)
    position, yaw = cloud_information(cloud_of("vlp16", wall))
    assert 10**position == pytest.approx(0.5, abs=0.03)
    assert yaw < -3.9


def test_a_model_is_monotonic_and_gets_no_bolder_beyond_what_was_studied() -> None:
    model = LogisticModel(np.array([1.0]), np.array([0.5]), np.array([2.0, 0.3]))
    found = model.probability(np.array([[0.0], [1.0], [2.0], [2.5], [100.0]]))
    assert (np.diff(found[:4]) > 0).all()
    assert found[1] == pytest.approx(1 / (1 + math.exp(-0.3)))
    assert found[3] == found[4]


def test_a_forecast_tells_walls_from_bare_hills_and_is_only_given_for_what_was_studied(room: str) -> None:
    walls = build_scenario(replace(CONFIG, source=room)).world
    x = np.linspace(-10, 10, 201)
    waves = (0.3 * np.sin(x)[None] * np.cos(x)[:, None]).astype(np.float32)
    bare = World("bare", Terrain(HeightField.centered(waves, (0.1, 0.1))))
    seen, blind = DriveSite(walls, CONFIG).features(), DriveSite(bare, CONFIG).features()
    assert forecast(blind, CONFIG) < 0.5 < forecast(seen, CONFIG)
    assert blind.wall_scans == 0.0
    assert seen.wall_scans == 1.0
    for other in ({"attitude": "none"}, {"mapper": "cartographer"}, {"odometry_noise": 2.0}):
        assert forecast(seen, replace(CONFIG, **other)) is None


@pytest.mark.slow
@pytest.mark.parametrize("walled", [True, False])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_window_with_walls_is_found_in_a_large_source(walled: bool, tmp_path: Path) -> None:
    heights = np.tile(np.linspace(0, 60, 481), (481, 1)).astype(np.uint8)
    if walled:  # the walls of a yard in the northeast, 3 m high
        heights[38:42, 338:372] = heights[58:62, 338:372] = 255
        heights[38:62, 338:342] = heights[38:62, 368:372] = 255
    picture = tmp_path / "plain.png"
    assert cv2.imwrite(str(picture), heights)
    config = RunConfig(source=str(picture), mapper="hector", build=BuildOptions(size=(240, 240), height=4))
    found = changes(DriveSite(build_scenario(config).world, config), short=False)
    windows = [window for other in found.values() if (window := other.build.window) is not None]
    assert len(windows) == walled
    for x, y, side in windows:
        assert max(abs(x - 57.5), abs(y - 95)) < side / 2, "the walls are in it"
