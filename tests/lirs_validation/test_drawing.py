"""Pictures of runs, logs and worlds: north is up, panels show the same meters, no text lies on another."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lirs_validation import map_log, validate
from lirs_validation.config import RunConfig
from lirs_validation.drawing import overview_figure, shown_bounds
from lirs_validation.record.run_record import RunRecord
from lirs_wct.drawing.canvas import Canvas, Drawing, bounds_of, shaded_heights, shaded_surface
from lirs_wct.drawing.pictures import block_picture, mesh_view, view_figure
from lirs_wct.geometry import HeightField, OccupancyGrid, WallGrid
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.pose import AZIMUTH, ELEVATION, Pose2, Trajectory, camera_axes
from lirs_wct.ground import LaserMap, Terrain
from lirs_wct.world import World


def hill(n: int = 65, size: float = 20.0) -> HeightField:
    at = np.linspace(-1, 1, n)
    x, y = np.meshgrid(at, at[::-1])
    return HeightField.centered((3 * np.exp(-4 * (x**2 + y**2))).astype(np.float32), (size / (n - 1),) * 2)


def room() -> World:
    """6 x 4 m of floor with walls all round and a block in the north-east corner."""
    p = np.zeros((40, 60))
    p[[0, -1]], p[:, [0, -1]] = 1.0, 1.0
    p[30:36, 45:55] = 1.0
    truth = OccupancyGrid.from_probability(p, 0.1, Pose2(-1.0, -2.0))
    walls = WallGrid(truth.occupied, 0.1, truth.origin)
    floor = HeightField(np.zeros((2, 2), np.float32), (6.0, 4.0), (-1.0, -2.0))
    return World("room", LaserMap(floor, walls, truth), (Pose2(1, 0, 0.5),))


def test_light_comes_from_the_north_west() -> None:
    light = shaded_surface(hill(), Canvas.over(hill().bounds, 200)).sum(axis=-1)
    quarter, three = 75, 125
    assert light[quarter, quarter] > light[three, three]


def test_level_ground_is_even() -> None:
    level = HeightField.centered(np.zeros((20, 30), np.float32), (0.1, 0.1))
    assert np.ptp(shaded_surface(level, Canvas.over(level.bounds, 60)), axis=(0, 1)).max() == 0.0


def test_north_is_up_and_walls_are_dark() -> None:
    world = room()
    canvas = Canvas.over(world.surface.bounds, 120)
    rgb = shaded_heights(world, canvas)
    dark = rgb[..., 0] < 0.3
    # The block: x 3.5..4.5, y 1.0..1.6 in the world; row 0 of the picture is north (y = 2).
    assert dark[int((2 - 1.3) / canvas.pixel), int((4.0 + 1) / canvas.pixel)]
    assert not dark[int((2 + 1.3) / canvas.pixel), int((4.0 + 1) / canvas.pixel)]


def test_thin_walls_survive_in_coarse_pixels() -> None:
    solid = np.zeros((400, 400), np.bool_)
    solid[:, 133] = True
    canvas = Canvas.over((0.0, 0.0, 20.0, 20.0), 50)
    assert canvas.mark_pixels(solid, WallGrid(solid, 0.05)).any(axis=1).all()


def test_a_turned_map_lies_where_its_points_lie() -> None:
    p = np.full((20, 30), 0.1)
    p[4, 25] = 0.9
    grid = OccupancyGrid.from_probability(p, 0.1, Pose2(1.0, 2.0, 0.8))
    canvas = Canvas.over((-3.0, 0.0, 5.0, 8.0), 400)
    rows, cols = np.nonzero(canvas.mark_pixels(grid.occupied, grid))
    seen = canvas.centers[rows, cols].mean(axis=0)
    assert seen == pytest.approx(grid.centers((4, 25)), abs=0.02)
    bounds = bounds_of(grid)
    assert bounds[0] < seen[0] < bounds[2]
    assert bounds[1] < seen[1] < bounds[3]


def test_walls_of_a_map_stand_out_in_the_oblique_view() -> None:
    image = block_picture(room(), width=300)
    assert image.shape[1] == 300
    assert image[0, 0, 3] == 0.0  # transparent around the block
    seen = image[image[..., 3] == 1][:, :3]
    floor, walls = (seen.min(axis=1) > 0.8), (seen.max(axis=1) < 0.6)
    assert floor.mean() > 0.2
    assert walls.mean() > 0.2
    assert (floor | walls).mean() > 0.97  # the rest is outlines


def boxes_apart(figure: Drawing) -> None:
    """No two texts above a panel lie on one another, and none leaves the picture."""
    figure.draw_without_rendering()
    for axes in figure.axes:
        texts = [t for t in (axes.title, axes._left_title, axes._right_title) if t.get_text()]  # type: ignore[attr-defined]
        boxes = [t.get_window_extent() for t in texts]
        boxes += [axes.get_legend().get_window_extent()] if axes.get_legend() else []
        assert all(not a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])
        assert all(b.x1 <= figure.bbox.x1 and b.y1 <= figure.bbox.y1 + 1 for b in boxes)


@pytest.mark.parametrize("name", ["room", "a_world_whose_name_is_so_long_that_it_takes_two_lines_of_a_panel"])
def test_title_and_legend_are_apart(name: str) -> None:
    boxes_apart(view_figure(replace(room(), name=name)))


def ring(height: float = 1.0) -> TriangleMesh:
    """A ring that stands on its edge, 4 m across."""
    shape = trimesh.creation.annulus(1.0, 2.0, 1.5)
    shape.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    return TriangleMesh(np.array(shape.vertices) * (1, 1, height), np.array(shape.faces, np.int32))


@pytest.mark.parametrize("height", [0.3, 1.0, 40.0])
def test_a_mesh_is_seen_in_its_own_proportions(height: float) -> None:
    mesh = ring(height)
    image = mesh_view(mesh, width=300)
    _, right, up = camera_axes(AZIMUTH, -ELEVATION) @ mesh.vertices.T
    seen = np.nonzero(image[..., 3])
    tall, wide = (float(np.ptp(at)) + 1 for at in seen)
    assert tall / wide == pytest.approx(float(np.ptp(up) / np.ptp(right)), rel=0.05)
    assert image.shape[0] <= 1602
    assert image.shape[1] <= 300


def test_a_terrain_that_is_not_square_is_seen_as_its_mesh() -> None:
    slope = np.tile(np.linspace(0, 8, 91, dtype=np.float32), (31, 1))
    world = World("slope", Terrain(HeightField.centered(slope, (0.5, 0.5))))
    np.testing.assert_allclose(block_picture(world, 300), mesh_view(world.mesh, width=300), atol=0.02)


def record(status: str = "ok", series: tuple[float, ...] = (40.0, 50.0, 60.0)) -> RunRecord:
    return RunRecord(
        config=RunConfig(source="room", seconds=3.0),
        world={"name": "room"},
        status=status,  # type: ignore[arg-type]
        reason="" if status == "ok" else "it fell",
        rtf={"mean": 48.0, "std": 8.0, "series": list(series)},
        trajectory={"ate_rmse": 0.02, "length": 2.0},
        map={"f1": 0.93, "f1_aligned": 0.99},
        collisions={},
        mapper={},
        versions={},
        machine={},
    )


def drive() -> tuple[World, Trajectory, OccupancyGrid]:
    world = room()
    path = [Pose2(0.1 * k, 0.2 * math.sin(k), 0.0) for k in range(20)]
    assert world.truth is not None
    return world, Trajectory.from_poses([0.1 * k for k in range(20)], path), world.truth


@pytest.mark.parametrize("status", ["ok", "tipped"])
def test_an_overview_shows_the_same_meters_in_all_panels(status: str, tmp_path: Path) -> None:
    world, truth, grid = drive()
    figure = overview_figure(world, record(status), (truth, truth), grid, grid, grid)
    panels = {axes.get_title(loc="left"): axes for axes in figure.axes}
    names = ["Input map and paths", "Map at the true poses", "Built map", "Built map, aligned"]
    assert len({(*panels[n].get_xlim(), *panels[n].get_ylim()) for n in names}) == 1
    texts = {t.get_text() for axes in figure.axes for t in axes.texts}
    assert {"0.020 m", "99 %"} <= texts
    assert ("it fell" in figure.get_suptitle()) == (status != "ok")
    figure.savefig(tmp_path / "overview.png")
    assert (tmp_path / "overview.png").stat().st_size > 20_000


def test_an_overview_of_a_run_that_hardly_began() -> None:
    world, truth, _ = drive()
    nothing = OccupancyGrid(np.full((4, 4), np.nan, np.float32), 0.05)
    one = Trajectory(truth.stamps[:1], truth.positions[:1], truth.quaternions[:1])
    figure = overview_figure(world, record("diverged", ()), (one, one), nothing, nothing)
    figure.canvas.draw()
    west, south, east, north = shown_bounds(world, one, nothing)
    assert east - west >= 2.0
    assert north - south >= 2.0


def test_what_is_off_stands_out() -> None:
    world, truth, grid = drive()
    wrong = grid.moved(Pose2(0.3, 0.0, 0.0))
    figure = overview_figure(world, record(), (truth, truth), grid, wrong, grid)
    found = {}
    for name in ("Built map", "Built map, aligned"):
        axes = next(a for a in figure.axes if a.get_title(loc="left") == name)
        picture = np.asarray(axes.images[0].get_array()) / 255
        found[name] = [
            int((np.abs(picture - color).max(axis=-1) < 0.01).sum())
            for color in ((0.835, 0.369, 0.0), (0.0, 0.447, 0.698))
        ]
    off, missing = found["Built map"]
    assert off > 100
    assert missing > 100
    assert found["Built map, aligned"] == [0, 0]


def rows_apart(figure: Drawing) -> None:
    """No two names, and no two values, of a list of metrics lie on one another."""
    figure.draw_without_rendering()
    for axes in figure.axes:
        for side in ("left", "right"):
            boxes = [t.get_window_extent() for t in axes.texts if t.get_ha() == side]
            assert all(upper.y0 >= lower.y1 - 1 for upper, lower in pairwise(boxes))


def test_a_run_on_a_laser_map(room: str) -> None:
    figure = validate(room, seconds=0.5).overview()
    boxes_apart(figure)
    rows_apart(figure)


def test_a_log_with_plots_of_its_errors(finished_run: Path) -> None:
    mapped = map_log(
        finished_run / "scans.clf.gz", mapper="hector", second="none", reference=finished_run / "truth.tum"
    )
    figure = mapped.overview()
    assert len(figure.axes) == 3
    boxes_apart(figure)
    rows_apart(figure)
