"""Navigation: cells away from walls, steep ground, border and the unknown, and starts on them."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_wct.geometry import HeightField, OccupancyGrid, WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import LaserMap, Terrain
from lirs_wct.navigation import mapped_area, spawn_poses
from lirs_wct.sources.build import build_world
from lirs_wct.sources.source import BuildOptions
from lirs_wct.world import World

SLOPE = math.radians(20)


def at(grid: OccupancyGrid, x: float, y: float) -> bool:
    row, col = grid.cells((x, y))
    return bool(grid.free[row, col])


def traversable(surface: HeightField, *, clearance: float, max_slope: float) -> OccupancyGrid:
    return World("ground", Terrain(surface)).traversable(clearance=clearance, max_slope=max_slope)


def flat(side: float = 10.0, cell: float = 0.1) -> np.ndarray:
    return np.zeros((round(side / cell) + 1,) * 2, np.float32)


@pytest.mark.parametrize("cell", [0.05, 0.25, 1.0])
def test_a_ramp_is_driven_up_to_the_limit(cell: float) -> None:
    x = np.arange(round(10 / cell) + 1) * cell
    for degrees, drivable in ((15, True), (25, False)):
        z = np.tile((x * math.tan(math.radians(degrees))).astype(np.float32), (len(x), 1))
        field = HeightField.centered(z, (cell, cell))
        grid = traversable(field, clearance=0.5, max_slope=SLOPE)
        assert at(grid, 0, 0) is drivable
        turned = HeightField.centered(np.ascontiguousarray(z.T), (cell, cell))
        assert at(traversable(turned, clearance=0.5, max_slope=SLOPE), 0, 0) is drivable


def test_clearance_is_kept_from_a_block_and_from_the_border() -> None:
    z = flat()
    z[45:56, 45:56] = 1.0  # 1 m wide, in the middle
    grid = traversable(HeightField.centered(z, (0.1, 0.1)), clearance=0.5, max_slope=SLOPE)
    assert not at(grid, 0.9, 0)
    assert at(grid, 1.4, 0)
    assert not at(grid, 4.7, 3)
    assert at(grid, 4.2, 3)


def test_small_steps_are_roughness_not_slope() -> None:
    z = flat()
    z[:, 50:] = 0.03
    assert at(traversable(HeightField.centered(z, (0.1, 0.1)), clearance=0.3, max_slope=SLOPE), 0, 0)


def test_walls_and_unknown_cells_of_a_turned_map_block() -> None:
    origin = Pose2(1.0, 2.0, 0.5)
    solid = np.zeros((60, 80), np.bool_)
    solid[:, 40] = True
    p = np.where(solid, 1.0, 0.0)
    p[:20] = np.nan
    truth = OccupancyGrid.from_probability(p, 0.1, origin)
    walls = WallGrid(solid, 0.1, origin)
    low, high = walls.corners.min(axis=0), walls.corners.max(axis=0)
    floor = HeightField(np.zeros((2, 2), np.float32), tuple(high - low), tuple(low))
    world = World("map", LaserMap(floor, walls, truth))
    grid = world.traversable(clearance=0.4, max_slope=SLOPE)
    for local, drivable in (((2.0, 4.0), True), ((3.7, 4.0), False), ((2.0, 1.0), False), ((6.0, 4.0), True)):
        assert at(grid, *origin.apply(local)) is drivable


def test_starts_lie_in_one_free_area_and_apart() -> None:
    p = np.ones((100, 100))
    p[10:90, 10:60] = 0.0
    p[10:20, 80:90] = 0.0
    grid = OccupancyGrid.from_probability(p, 0.1)
    starts = spawn_poses(grid, 5)
    assert len(starts) == 5
    assert all(1.0 <= s.y <= 9.0 and 1.0 <= s.x <= 6.0 for s in starts)
    assert min(a.distance(b) for a in starts for b in starts if a is not b) > 1.5


def test_no_free_ground_gives_no_start() -> None:
    assert spawn_poses(OccupancyGrid.from_probability(np.ones((5, 5)), 0.1)) == ()


def test_slopes_strip_by_strip_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    z = np.random.default_rng(2).random((90, 70)).astype(np.float32)
    surface = HeightField.centered(cv2.GaussianBlur(z, (0, 0), 6) * 3, (0.04, 0.05))
    whole = traversable(surface, clearance=0.1, max_slope=0.3)
    assert 0.05 < whole.free.mean() < 0.95
    monkeypatch.setattr("lirs_wct.navigation._STRIP", 7)
    strips = traversable(surface, clearance=0.1, max_slope=0.3)
    np.testing.assert_array_equal(whole.log_odds, strips.log_odds)


def test_grids_of_several_limits_are_those_of_each() -> None:
    z = np.random.default_rng(1).normal(0, 0.02, (40, 50)).astype(np.float32)
    surface = HeightField.centered(z, (0.1, 0.1))
    limits = [(0.1, 0.2), (0.2, 0.4), (0.1, 0.1)]
    grids = World("ground", Terrain(surface)).traversable_by(limits, 0.1)
    for (clearance, slope), grid in zip(limits, grids, strict=True):
        alone = traversable(surface, clearance=clearance, max_slope=slope)
        np.testing.assert_array_equal(grid.free, alone.free)


@pytest.mark.parametrize("slope", [18.0, 24.0, 26.0, 32.0])
def test_a_ramp_of_millimeters_is_judged_as_a_coarse_one(slope: float) -> None:
    x = np.arange(501) * 0.003
    z = np.tile((x * math.tan(math.radians(slope))).astype(np.float32), (501, 1))
    grid = traversable(HeightField.centered(z, (0.003, 0.003)), clearance=0.2, max_slope=math.radians(25.0))
    assert at(grid, 0, 0) == (slope < 25)


def test_a_thin_wall_on_a_fine_surface_blocks() -> None:
    z = np.zeros((501, 501), np.float32)
    z[:, 250:252] = 0.3
    grid = traversable(HeightField.centered(z, (0.003, 0.003)), clearance=0.2, max_slope=math.radians(25.0))
    assert not at(grid, 0, 0)
    assert at(grid, -0.45, 0)


def ring(origin: Pose2, inner: float = 8.0, outer: float = 10.0) -> OccupancyGrid:
    """Return a track between two circles of walls around (15, 15) of the grid; free inside and outside."""
    y, x = (np.indices((300, 300)) + 0.5) * 0.1
    radius = np.hypot(x - 15, y - 15)
    wall = (np.abs(radius - inner) < 0.2) | (np.abs(radius - outer) < 0.2)
    return OccupancyGrid.from_probability(np.where(wall, 1.0, 0.0), 0.1, origin)


def test_the_area_at_the_maps_origin_is_where_it_was_made() -> None:
    for at, radii in (((15.0, 24.0), (8, 10)), ((15.0, 15.0), (0, 8)), ((1.0, 1.0), (10, 22))):
        free = ring(Pose2(-at[0], -at[1]))
        found = free.centers(np.argwhere(mapped_area(free, 0.1))) + np.array(at) - 15
        radius = np.hypot(*found.T)
        assert len(found) > 100
        assert radii[0] < radius.min() <= radius.max() < radii[1]


def test_without_free_ground_at_the_origin_the_track_is_meant_not_its_infield() -> None:
    free = ring(Pose2(100.0, 50.0))
    found = free.centers(np.argwhere(mapped_area(free, 0.1))) - np.array((115.0, 65.0))
    radius = np.hypot(*found.T)
    assert 8 < radius.min() <= radius.max() < 10
    assert radius.max() - radius.min() > 1.5


def test_a_closet_at_the_origin_is_not_the_map() -> None:
    p = np.ones((100, 100))
    p[1:5, 1:5] = 0.0
    p[10:90, 10:90] = 0.0
    area = mapped_area(OccupancyGrid.from_probability(p, 0.1, Pose2(-0.3, -0.3)), 0.1)
    assert area[50, 50]
    assert not area[3, 3]
    assert not mapped_area(OccupancyGrid.from_probability(np.ones((5, 5)), 0.1), 0.1).any()


def test_in_a_corridor_a_start_faces_along_it() -> None:
    y, x = (np.indices((300, 300)) + 0.5) * 0.1
    track = np.abs(np.hypot(x - 15, y - 15) - 9) < 0.5
    free = OccupancyGrid.from_probability(np.where(track, 0.0, 1.0), 0.1, Pose2(100.0, 50.0))
    for pose in spawn_poses(free, corridors=True):
        outward = math.atan2(pose.y - 65.0, pose.x - 115.0)
        assert abs(math.sin(pose.yaw - outward)) > 0.7
    assert any(
        abs(math.sin(pose.yaw - math.atan2(pose.y - 65, pose.x - 115))) < 0.3 for pose in spawn_poses(free)
    )


@pytest.mark.shared
@pytest.mark.parametrize("track", ["Austin", "Spielberg"])
def test_all_starts_of_a_race_track_are_on_the_track(shared_data: Path, track: str) -> None:
    world = build_world(shared_data / f"maps/f1tenth_racetracks/{track}_map.yaml", BuildOptions())
    free = world.traversable(clearance=0.05, max_slope=0.2)
    _, labels = cv2.connectedComponents(free.free.astype(np.uint8), connectivity=4)
    row, col = free.cells((0.0, 0.0))
    assert labels[row, col]
    assert len(world.spawn_poses) == 8
    assert world.spawn_for == "husky"
    for pose in world.spawn_poses:
        row_, col_ = free.cells((pose.x, pose.y))
        assert labels[row_, col_] == labels[row, col]
