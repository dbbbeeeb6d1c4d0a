"""The forecast: what the beams of a scan meet, in worlds where geometry gives the answer."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from lirs_envs.robots.robot import make_robot
from lirs_validation.metrics.scan_support import (
    POSES,
    ScanSupport,
    observed_support,
    scan_support,
    standing_on,
)
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan
from lirs_wct.ground import Terrain
from lirs_wct.world import World

HUSKY = make_robot("husky")


def terrain(z: np.ndarray, cell: float = 0.1) -> World:
    field = HeightField.centered(z.astype(np.float32), (cell, cell))
    return World("made", Terrain(field), spawn_poses=(Pose2(),))


def axes(n: int = 401) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the nodes, row 0 = north."""
    axis = (np.arange(n) - n // 2) * 0.1
    return np.meshgrid(axis, -axis)


def test_level_ground_returns_nothing() -> None:
    found = scan_support(terrain(np.zeros((401, 401))), HUSKY)
    assert (found.wall_median, found.ground_median, found.wall_share) == (0.0, 0.0, 0.0)
    assert found.poses == POSES
    assert found.expectation == "walls on 0 of 541 beams: too few for planar mapping"


def test_the_robot_stands_as_the_ground_lies() -> None:
    x, y = axes()
    world = terrain(0.2 * x + 0.1 * y)
    T = standing_on(world, HUSKY, Pose2(1.0, 2.0, math.pi / 2))
    ahead, left = T.rotation[:, 0], T.rotation[:, 1]
    assert ahead[2] / math.hypot(*ahead[:2]) == pytest.approx(0.1, abs=0.01), "north rises by 0.1"
    assert left[2] / math.hypot(*left[:2]) == pytest.approx(-0.2, abs=0.01), "west falls by 0.2"
    assert T.z == pytest.approx(0.2 * 1.0 + 0.1 * 2.0 + HUSKY.base_height, abs=1e-6)
    flying = standing_on(world, make_robot("quadrotor"), Pose2(1.0, 2.0, 0.3))
    assert (flying.roll, flying.pitch) == pytest.approx((0.0, 0.0))
    assert flying.z == pytest.approx(0.4 + make_robot("quadrotor").base_height, abs=1e-6)


@pytest.mark.parametrize(
    ("least", "median", "expected"),
    [
        (5.0, 5.0, "walls on 5 of 100 beams: enough for planar mapping nearly everywhere"),
        (4.0, 5.0, "walls on 4 to 5 of 100 beams: too few for planar mapping in some places"),
        (4.0, 4.0, "walls on 4 of 100 beams: too few for planar mapping"),
    ],
)
def test_a_twentieth_of_the_beams_is_enough(least: float, median: float, expected: str) -> None:
    found = ScanSupport(robot="husky", beams=100, poses=1, wall_p10=least, wall_median=median)
    assert found.expectation == expected


def test_a_pit_with_steep_walls_is_all_walls_and_one_with_gentle_ones_all_ground() -> None:
    x, y = axes()
    rim = np.maximum(np.abs(x), np.abs(y)) - 6.0
    steep = scan_support(terrain(np.clip(rim, 0, 0.2) * 20), HUSKY)
    gentle = scan_support(terrain(np.maximum(rim, 0) * math.tan(math.radians(35))), HUSKY)
    assert steep.wall_share > 0.99
    assert gentle.wall_share < 0.01
    assert gentle.ground_p10 == gentle.beams


def test_ground_that_the_start_does_not_reach_does_not_count() -> None:
    """A race track in an open field was expected to show no walls."""
    x, y = axes()
    ring = np.abs(np.maximum(np.abs(x), np.abs(y)) - 4.0) < 0.3
    world = terrain(np.where(ring, 3.0, 0.0))
    found = scan_support(world, HUSKY)
    assert found.wall_p10 == found.beams
    outside = replace(world, spawn_poses=(Pose2(15.0, 0.0),))
    assert scan_support(outside, HUSKY).wall_median < 0.3 * found.beams


def test_the_hits_of_a_wall_are_those_within_its_angle_and_the_range() -> None:
    """A wall 40 m long all along one side: from y it spans an angle that is computed here by hand."""
    _, y = axes()
    world = terrain(np.where(y > 19.0, 3.0, 0.0))
    found = scan_support(world, HUSKY)
    rng = np.random.default_rng(0)
    expected = []
    for px, py, yaw in zip(
        rng.uniform(-19, 19, 4000), rng.uniform(-19, 18, 4000), rng.uniform(0, 2 * math.pi, 4000), strict=True
    ):
        bearing = yaw + np.radians(np.linspace(-135, 135, found.beams))
        away = (19.0 - py) / np.maximum(np.sin(bearing), 1e-9)
        along = px + away * np.cos(bearing)
        expected.append(int(((np.sin(bearing) > 0) & (away < 20.0) & (np.abs(along) < 20.0)).sum()))
    assert found.wall_median == pytest.approx(np.median(expected), rel=0.15, abs=5)


def test_a_robot_that_fits_nowhere_has_no_forecast() -> None:
    x, _ = axes()
    found = scan_support(terrain(x * math.tan(math.radians(40))), HUSKY)
    assert asdict(found) == {"robot": "husky", "beams": 541, "poses": 0} | dict.fromkeys(
        ("wall_median", "wall_p10", "ground_median", "ground_p10", "wall_share"), 0.0
    )
    assert found.expectation == "the robot can stand nowhere"


def test_recorded_hits_are_of_walls_where_they_end_at_steep_faces() -> None:
    x, _ = axes()
    world = terrain(np.where(np.abs(x) > 5.0, 3.0, 0.0))  # walls 5 m to the west and to the east
    angles = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    ranges = np.minimum(5.05 / np.maximum(np.abs(np.cos(angles)), 1e-9), 10.0)
    ranges[ranges >= 10.0] = np.inf
    scan = LaserScan(ranges.astype(np.float32), -math.pi, 2 * math.pi / 360, 0.1, 20.0, 0.0)
    turned = Pose3.from_pose2(Pose2(0.0, 1.0, math.pi), 0.5)
    found = observed_support(world, [scan, scan], [Pose3(z=0.5), turned])
    hits = float(scan.hits.sum())
    for aside, walls in ((0.09, True), (0.11, False)):  # of the eastern face, which is at x = 5 ... 5.1
        short = LaserScan(np.array([5.0 - aside], np.float32), 0.0, 0.1, 0.1, 20.0, 0.0)
        assert (observed_support(world, [short], [Pose3(z=0.5)])["walls_median"] == 1.0) == walls
    assert found == {"beams": 360, "range_max": 20.0, "returns_median": hits, "walls_median": hits}
    assert hits == (np.abs(np.cos(angles)) > 0.505).sum()
