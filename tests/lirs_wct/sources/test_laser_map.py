"""Laser maps become walls on a level floor."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.map_server import read_map
from lirs_wct.geometry import OccupancyGrid, WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.meshing.walls import SLAB, merged_rectangles, wall_mesh
from lirs_wct.sources.laser_map import level_floor, read_laser_map, walls_of, without_small_walls
from lirs_wct.sources.source import BuildOptions, find_source


def test_unknown_cells_are_floor_wall_or_hole() -> None:
    p = np.array([[0.0, 1.0, np.nan], [np.nan, 0.5, 0.0]])
    grid = OccupancyGrid.from_probability(p, 0.1)
    assert walls_of(grid, 1.0).solid.tolist() == [[False, True, False], [False, False, False]]
    assert walls_of(grid, 1.0).hole is None
    assert walls_of(grid, 1.0, "wall").solid.tolist() == [[False, True, True], [True, False, False]]
    holed = walls_of(grid, 1.0, "hole")
    assert holed.hole.tolist() == [[False, False, True], [True, False, False]]
    assert holed.floor.tolist() == [[True, False, False], [False, True, True]]
    with pytest.raises(ConfigError, match="floor, hole, wall"):
        walls_of(grid, 1.0, "sea")  # type: ignore[arg-type]
    nothing = OccupancyGrid.from_probability(np.full((2, 2), np.nan), 0.1)
    with pytest.raises(ConfigError, match="every cell is a hole"):
        walls_of(nothing, 1.0, "hole")


def test_speckles_are_dropped_by_their_size() -> None:
    p = np.zeros((9, 9))
    p[0, 0] = p[1, 1] = p[2, 2] = 1.0  # three that touch at corners
    p[5, 5:7] = p[8, 0] = 1.0
    p[8, 8] = np.nan
    grid = OccupancyGrid.from_probability(p, 0.1)
    for least, left in ((0, 6), (1, 6), (2, 5), (3, 3), (4, 0)):
        cleaned = without_small_walls(grid, least)
        assert cleaned.occupied.sum() == left, least
        assert np.array_equal(cleaned.known, grid.known)
        assert cleaned.free.sum() == 80 - left
    assert without_small_walls(grid, 3).occupied[1, 1]


def test_walls_lie_as_their_map_does() -> None:
    p = np.array([[0.9, 0.1, 0.66], [0.64, 0.1, np.nan]])
    grid = OccupancyGrid.from_probability(p, 0.25, Pose2(-3.0, 8.0, 0.5))
    for unknown in ("floor", "wall", "hole"):
        walls = walls_of(grid, 1.75, unknown)  # type: ignore[arg-type]
        assert (walls.resolution, walls.origin, walls.height) == (0.25, grid.origin, 1.75)
        assert walls.solid.tolist() == [[True, False, True], [False, False, unknown == "wall"]]
    everything = OccupancyGrid.from_probability(np.full((2, 3), 0.1), 0.25)
    assert walls_of(everything, 1.0, "hole").hole is None
    with pytest.raises(ConfigError, match="height"):
        walls_of(grid, 0.0)


def test_the_floor_lies_under_the_whole_turned_map() -> None:
    """Four cells east and two north of half a meter, turned by 30 deg about its corner."""
    walls = WallGrid(np.ones((2, 4), np.bool_), 0.5, Pose2(10.0, -5.0, math.pi / 6), 3.0)
    floor = level_floor(walls)
    c, s = math.cos(math.pi / 6), 0.5
    assert floor.bounds == pytest.approx((10 - s, -5, 10 + 2 * c, -5 + 2 * s + c))
    assert floor.z.tolist() == [[0, 0], [0, 0]]
    upright = level_floor(WallGrid(walls.solid, 0.5, Pose2(1.0, 2.0)))
    assert upright.bounds == (1.0, 2.0, 3.0, 3.0)


@pytest.mark.parametrize("origin", [None, Pose2(-4, 3)])
def test_a_map_becomes_ground(tmp_path: Path, origin: Pose2 | None) -> None:
    pixels = np.full((40, 60), 254, np.uint8)
    pixels[0], pixels[30, 5:9], pixels[20, 20], pixels[35:, 50:] = 0, 0, 0, 205
    cv2.imwrite(str(tmp_path / "m.pgm"), pixels)
    path, given = tmp_path / "m.pgm", BuildOptions(kind="map", resolution=0.5)
    if origin is not None:
        path, given = tmp_path / "m.yaml", BuildOptions()
        path.write_text("image: m.pgm\nresolution: 0.5\norigin: [-4, 3, 0]\n")
    options = replace(given, wall_height=1.5, unknown="wall", speckle=2)
    ground, scale, place = read_laser_map(find_source(path, options), options)
    assert place is None
    assert scale == "0.5 m a cell"
    origin = origin or Pose2()
    assert (ground.walls.height, ground.walls.origin, ground.walls.resolution) == (1.5, origin, 0.5)
    expected = (pixels == 0) | (pixels == 205)
    expected[20, 20] = False  # a speckle
    np.testing.assert_array_equal(ground.walls.solid, expected[::-1])
    x, y = origin.x, origin.y
    assert ground.surface.bounds == (x, y, x + 30, y + 20)
    window = replace(options, window=(x + 10.0, y + 5.0, 3.9))
    cut, *_ = read_laser_map(find_source(path, options), window)
    assert cut.walls.shape == (8, 8)
    assert cut.walls.origin == Pose2(x + 8.0, y + 3.0)
    with pytest.raises(SourceError, match="at most 2399 are allowed"):
        read_laser_map(find_source(path, options), replace(options, max_pixels=2399))


def test_a_picture_of_a_map_needs_its_resolution(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "m.pgm"), np.full((4, 4), 254, np.uint8))
    options = BuildOptions(kind="map")
    with pytest.raises(ConfigError, match=r"m\.pgm: a map picture without YAML needs --resolution"):
        read_laser_map(find_source(tmp_path / "m.pgm", options), options)


@pytest.mark.shared
def test_real_maps_become_closed_solids_of_few_boxes(shared_data: Path) -> None:
    """As many boxes as plain greedy rectangles give, or fewer; the plan's walls to the millimeter."""
    most = {"map": 214, "willow-2010-02-18-0.10": 453, "depot": 1307}
    read = 0
    for path in sorted(shared_data.glob("maps/*/*.yaml")):
        try:
            grid = read_map(path)
        except SourceError as error:
            assert "is not there" in str(error)  # noqa: PT017
            continue
        read += 1
        walls = walls_of(grid, 2.5)
        assert len(merged_rectangles(walls.solid)) <= most.get(path.stem, len(walls.solid) ** 2)
        mesh = wall_mesh(walls)
        assert mesh.is_watertight
        assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_watertight
        volume = walls.resolution**2 * (walls.solid.size * SLAB + walls.solid.sum() * 2.5)
        assert mesh.volume == pytest.approx(volume, rel=1e-3)  # corners that touch stand a millimeter apart
    assert read == 10
