"""The coverage driver on a robot without physics: it covers ground, hits nothing, knows when it is stuck."""

import math
from pathlib import Path

import numpy as np
import pytest

from lirs_envs.robots.robot import ROBOTS
from lirs_validation.driving.choice import driver_config
from lirs_validation.driving.path_driver import DriverConfig, PathDriver
from lirs_validation.driving.routes import TourRoute
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.navigation import spawn_poses
from lirs_wct.sources.build import build_world
from tests.lirs_validation.driving.ride import DT, MARGIN, ROBOT, corridor, field, ride


def route_on(free: OccupancyGrid, start: Pose2, seed: int = 0, seconds: float = 10.0) -> TourRoute:
    return TourRoute(free, start, np.random.default_rng(seed), seconds, DriverConfig())


def driver_on(free: OccupancyGrid, seed: int = 1) -> PathDriver:
    start = spawn_poses(free)[0]
    return PathDriver(route_on(free, start, seed, 120.0), start, DriverConfig())


@pytest.mark.parametrize("seed", range(4))
def test_it_covers_ground_among_obstacles_and_hits_none(seed: int) -> None:
    free, touching = field(seed)
    driver = driver_on(free, seed)
    result = ride(driver, driver.start, 120.0, seed=seed)
    assert result.length >= 60.0
    assert result.on_free(touching).all()
    assert not driver.stuck


@pytest.mark.parametrize("yaw_gain", [0.6, 1.4])
def test_it_stays_clear_with_a_robot_that_turns_too_little_or_too_much(yaw_gain: float) -> None:
    free, touching = field(7)
    driver = driver_on(free)
    result = ride(driver, driver.start, 120.0, yaw_gain=yaw_gain)
    assert result.length >= 40.0
    assert result.on_free(touching).all()


@pytest.mark.shared
@pytest.mark.parametrize("name", ["navigation2/depot.yaml", "mir_robot/maze.yaml"])
def test_it_drives_through_real_maps(name: str, shared_data: Path) -> None:
    world = build_world(shared_data / "maps" / name)
    free = world.traversable(clearance=ROBOT + MARGIN, max_slope=0.35)
    touching = world.traversable(clearance=ROBOT - 0.05, max_slope=0.35)
    start = spawn_poses(free)[0]
    route = route_on(free, start, 1, 120.0)
    result = ride(PathDriver(route, start, DriverConfig()), start, 120.0)
    assert result.length >= 60.0
    assert result.on_free(touching).all()
    assert route.coverage > 0.8


def test_the_same_seed_gives_the_same_tour_and_another_another() -> None:
    free, _ = field(3)
    one, same, other = (driver_on(free, seed).path for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not (one.shape == other.shape and np.allclose(one, other))


def test_a_tour_is_long_enough_evenly_spaced_and_free() -> None:
    free, _ = field(5)
    start = spawn_poses(free)[0]
    planner = route_on(free, start)
    points = planner.tour(start, 200.0)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() < 0.101
    assert 150.0 < steps.sum() < 260.0
    assert planner.ground.free[tuple(free.cells(points).T)].all()


def test_it_starts_from_rest_and_straight_ahead() -> None:
    free, _ = field(4)
    driver = driver_on(free)
    result = ride(driver, driver.start, 3.0, slip=0.0)
    speeds = np.linalg.norm(np.diff(result.poses[:, :2], axis=0), axis=1) / DT
    assert speeds[0] < 0.05
    assert np.diff(speeds).max() <= 0.6 * DT + 1e-6
    turned = np.abs(result.poses[:, 2] - driver.start.yaw)
    assert turned[np.cumsum(speeds * DT).searchsorted(0.5)] < 0.1


def test_coverage_does_not_see_through_walls() -> None:
    p = np.zeros((60, 60))
    p[:, 30] = 1.0
    p[55:, 30] = 0.0  # two rooms, joined at the north end
    free = OccupancyGrid.from_probability(p, 0.1)
    start = Pose2(2.6, 1.0, math.pi / 2)
    planner = route_on(free, start)
    assert planner.coverage == 0.0
    planner.tour(start, 0.5)
    assert 0.1 < planner.coverage <= 0.5


def test_a_robot_that_cannot_move_is_stuck_and_says_so() -> None:
    driver = driver_on(corridor(width=3.0))
    result = ride(driver, driver.start, 120.0, blocked=lambda pose: True)
    assert driver.stuck
    assert result.length == 0.0
    assert driver.command(driver.start, 121.0).v == 0.0


def test_it_backs_off_from_an_unknown_obstacle_and_goes_another_way() -> None:
    free, _ = field(1, obstacles=0, side=20.0)
    driver = driver_on(free)
    # A post that the grid does not know, on the tour about 4 m ahead.
    x, y = driver.path[40].tolist()
    result = ride(driver, driver.start, 90.0, blocked=lambda pose: math.hypot(pose.x - x, pose.y - y) < 0.4)
    assert not driver.stuck
    assert result.length > 30.0
    assert np.hypot(result.poses[:, 0] - x, result.poses[:, 1] - y).min() >= 0.4


def test_a_start_outside_the_free_ground_leads_back_to_it() -> None:
    free = corridor(length=10.0, width=2.0)
    outside = Pose2(-0.5, 1.0, math.pi)
    driver = PathDriver(route_on(free, outside, seconds=20.0), outside, DriverConfig())
    result = ride(driver, outside, 20.0)
    assert result.on_free(free)[-1]


def test_no_free_ground_is_named() -> None:
    full = OccupancyGrid.from_probability(np.ones((5, 5)), 0.1)
    with pytest.raises(ConfigError, match="at least one free cell"):
        route_on(full, Pose2())


@pytest.mark.parametrize("name", list(ROBOTS))
def test_nobody_is_asked_for_more_than_he_has(name: str) -> None:
    robot, config = ROBOTS[name], driver_config(ROBOTS[name])
    assert config.pursuit.speed < robot.max_speed
    assert config.pursuit.turn_rate < robot.max_turn_rate
    assert config.pursuit.acceleration < robot.max_acceleration
    assert config.back_speed < robot.max_speed
    # It backs off equally far, and gives a robot the time that progress takes at its lowest speed.
    assert config.back_off * config.back_speed == pytest.approx(0.75)
    assert config.patience * 0.15 * config.pursuit.speed > config.step
