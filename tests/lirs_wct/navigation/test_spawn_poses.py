"""Which free area of a laser map is meant: where it was made, or what reaches around most behind walls."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.navigation import mapped_area, spawn_poses
from lirs_wct.sources.build import build_world
from lirs_wct.sources.source import BuildOptions


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
