"""Pictures of values and worlds: nothing leaves the figure, in files and in Jupyter."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from PIL import Image

from lirs_envs.robots.robot import ROBOTS, make_robot
from lirs_validation import validate
from lirs_wct.display import html_table
from lirs_wct.drawing.canvas import Drawing, new_figure, title
from lirs_wct.drawing.pictures import figure_of, view_figure
from lirs_wct.geometry import HeightField, OccupancyGrid, WallGrid
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.scan import LaserScan
from lirs_wct.ground import LaserMap, MeshGround, Terrain
from lirs_wct.world import World


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


LONG = "a_world_whose_name_is_so_long_that_it_takes_two_lines_of_a_panel"


def laser_map(rows: int, cols: int) -> World:
    p = np.zeros((rows, cols))
    p[[0, -1]], p[:, [0, -1]] = 1.0, 1.0
    truth = OccupancyGrid.from_probability(p, 0.1, Pose2(-30.0, 0.0))
    floor = HeightField(np.zeros((2, 2), np.float32), (cols * 0.1, rows * 0.1), (-30.0, 0.0))
    walls = WallGrid(truth.occupied, 0.1, truth.origin)
    return World("map", LaserMap(floor, walls, truth), (Pose2(-29.5, 0.5), Pose2(-29.0, 0.5, 3.0)))


def terrain(rows: int, cols: int, cell: float) -> World:
    z = np.random.default_rng(0).random((rows, cols)).astype(np.float32) * 3000
    return World(LONG, Terrain(HeightField.centered(z, (cell, cell))), (Pose2(),))


def tower() -> World:
    shape = trimesh.creation.cylinder(1.0, 40.0)
    solid = TriangleMesh(np.array(shape.vertices), np.array(shape.faces, np.int32))
    surface = HeightField.centered(np.full((9, 9), 20, np.float32), (0.25, 0.25))
    return World("tower", MeshGround(surface, solid, False, None), (Pose2(),))


WORLDS: dict[str, Callable[[], World]] = {
    "square map": lambda: laser_map(300, 300),
    "wide map": lambda: laser_map(20, 400),
    "tall map": lambda: laser_map(400, 20),
    "as wide as panels stand side by side": lambda: laser_map(100, 249),
    "as wide as they stand one above the other": lambda: laser_map(100, 251),
    "terrain of kilometers": lambda: terrain(60, 70, 2000.0),
    "tall terrain": lambda: terrain(300, 20, 1.0),
    "wide terrain": lambda: terrain(20, 300, 1.0),
    "tower": tower,
}


def drawn(figure: Drawing) -> FigureCanvasAgg:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas


def margins(canvas: FigureCanvasAgg) -> list[float]:
    """Return inches from what is drawn to the figure's edges."""
    figure = canvas.figure
    box, (width, height) = figure.get_tightbbox(canvas.get_renderer()), figure.get_size_inches()
    return [float(v) for v in (box.x0, box.y0, width - box.x1, height - box.y1)]


FAST = ("tower", "wide terrain", "wide map")


@pytest.mark.parametrize(
    "name", [*FAST, *(pytest.param(name, marks=pytest.mark.slow) for name in WORLDS if name not in FAST)]
)
def test_nothing_leaves_the_figure_and_panels_stay_apart(name: str) -> None:
    world = WORLDS[name]()
    canvas = drawn(view_figure(world))
    assert min(margins(canvas)) >= 0.0
    assert max(canvas.figure.get_size_inches()) <= 13.0
    above, oblique = canvas.figure.axes[:2]
    box, (width, depth) = above.get_window_extent(), world.surface.size
    assert box.width / box.height == pytest.approx(width / depth, rel=0.12)
    boxes = [axes.get_tightbbox(canvas.get_renderer()) for axes in (above, oblique)]
    assert boxes[0] is not None
    assert boxes[1] is not None
    assert not boxes[0].overlaps(boxes[1])
    labels = [label.get_window_extent() for label in above.get_xticklabels() if label.get_text()]
    shown = [b for b in labels if box.x0 - 1 <= (b.x0 + b.x1) / 2 <= box.x1 + 1]
    assert all(a.x1 < b.x0 for a, b in pairwise(shown))
