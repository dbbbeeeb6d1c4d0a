"""Values in Jupyter: a picture or a table, and a line of text that fits."""

from typing import Any

import cv2
import numpy as np
import pytest

from lirs_envs.robots.robot import ROBOTS, make_robot
from lirs_validation import validate
from lirs_wct.display import html_table
from lirs_wct.drawing.pictures import figure_of
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.scan import LaserScan
from lirs_wct.ground import Terrain
from lirs_wct.world import World

N = 129
X, Y = np.meshgrid(np.linspace(-1, 1, N), np.linspace(-1, 1, N))
HILL = HeightField.centered(np.exp(-4 * (X**2 + Y**2)).astype(np.float32), (0.4, 0.4))
RING = np.where(np.hypot(X, Y) < 0.5, 0.1, np.where(np.hypot(X, Y) < 0.55, 0.9, 0.5))
VALUES = {
    "World": World("hill", Terrain(HILL), spawn_poses=(Pose2(),)),
    "HeightField": HILL,
    "OccupancyGrid": OccupancyGrid.from_probability(RING, 0.05),
    "LaserScan": LaserScan(np.full(541, 5.0, np.float32), -2.36, 0.00872, 0.1, 20.0, 12.5),
    "Trajectory": Trajectory.from_poses(range(1000), [Pose2(0.1 * k, 0.0) for k in range(1000)]),
}


def shown(png: bytes) -> np.ndarray[Any, Any]:
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image


@pytest.mark.parametrize("name", VALUES)
def test_a_value_shows_itself_as_a_picture(name: str) -> None:
    value = VALUES[name]
    image = shown(value._repr_png_())
    assert 200 < image.shape[1] <= 900
    ink = (image.min(axis=2) < 235).mean()
    assert 0.003 < ink < 0.97
    assert repr(value).startswith(f"{name}(")
    assert len(repr(value)) < 300


def test_empty_values_show_themselves() -> None:
    """A scan without a hit, a map that knows nothing, a path of no length."""
    scan = LaserScan(np.full(10, np.inf, np.float32), 0.0, 0.1, 0.1, 20.0, 0.0)
    grid = OccupancyGrid(np.full((4, 4), np.nan, np.float32), 0.05)
    for value in (scan, grid, Trajectory.from_poses([0.0], [Pose2()]), Trajectory.from_poses([], [])):
        assert shown(value._repr_png_()).size
        assert len(repr(value)) < 300


def test_a_type_without_a_picture() -> None:
    with pytest.raises(TypeError, match="a int has no picture"):
        figure_of(3)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_shows_its_figures(name: str) -> None:
    robot = make_robot(name)
    html = robot._repr_html_()
    assert f"{robot.radius:g} m" in html
    assert robot.lidar in html
    assert len(repr(robot)) < 300


@pytest.mark.slow
def test_a_run_shows_itself() -> None:
    run = validate("simple", seconds=1)
    assert shown(run._repr_png_()).shape[1] > 600
    assert len(repr(run)) < 300
    html = run.record._repr_html_()
    assert f"{run.record.trajectory['ate_rmse']:.3f} m" in html
    assert len(repr(run.record)) < 300


def test_names_are_no_markup() -> None:
    assert html_table([("<b>", "a & b")]).count("&lt;b&gt;") == 1
