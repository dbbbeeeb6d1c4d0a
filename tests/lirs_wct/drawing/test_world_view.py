"""The picture of a world: nothing of it leaves the figure, whatever the world's proportions."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg

from lirs_wct.drawing.canvas import Drawing
from lirs_wct.drawing.pictures import view_figure
from lirs_wct.geometry.grid import OccupancyGrid, WallGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import LaserMap, MeshGround, Terrain
from lirs_wct.world import World

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
