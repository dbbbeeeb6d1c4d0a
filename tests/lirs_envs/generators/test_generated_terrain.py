"""Courses and floor plans: as they are called, with a way through."""

import math

import cv2
import numpy as np
import pytest

from lirs_envs.generators.floor_plan import CELL, SIZE, floor_plan
from lirs_envs.generators.terrain import (
    HEIGHT_RANGE,
    KINDS,
    NATURAL_TERRAINS,
    GeneratedTerrain,
    generate,
    scaled_height_range,
    with_rocks,
)
from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation_config import standing_pose
from lirs_wct.errors import ConfigError
from lirs_wct.ground import LaserMap
from lirs_wct.world import World

EVERY = [(kind, difficulty, seed) for kind in KINDS for difficulty in (0.0, 0.5, 1.0) for seed in (1, 2)]


def made(kind: str, difficulty: float, seed: int = 1, scale: float = 1.0) -> GeneratedTerrain:
    return generate(kind, difficulty, np.random.default_rng(seed), scale=scale)


@pytest.mark.parametrize(("kind", "difficulty", "seed"), EVERY)
def test_a_course_has_a_gentle_way_from_start_to_goal(kind: str, difficulty: float, seed: int) -> None:
    terrain = made(kind, difficulty, seed)
    assert terrain.heights.shape == (257, 257)
    assert terrain.heights.dtype == np.float32
    low, high = HEIGHT_RANGE
    assert low <= terrain.heights.min() <= terrain.heights.max() <= high
    assert terrain.start.x < -10 < 10 < terrain.goal.x
    assert terrain.route[0] == pytest.approx((terrain.start.x, terrain.start.y))
    assert terrain.route[-1] == pytest.approx((terrain.goal.x, terrain.goal.y))
    free = terrain.world().traversable(clearance=0.4, max_slope=math.radians(25))
    cells = free.cells(terrain.route)
    assert free.free[cells[:, 0], cells[:, 1]].all()


@pytest.mark.parametrize("name", ["husky", "turtlebot3_burger", "quadrotor"])
@pytest.mark.parametrize("kind", KINDS)
def test_robots_can_stand_at_start_and_goal(kind: str, name: str) -> None:
    robot = make_robot(name)
    terrain = made(kind, 1.0, scale=min(1.0, robot.radius / 0.58))
    for pose in (terrain.start, terrain.goal):
        standing_pose(terrain.world(), robot, pose)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "mazes"])
def test_a_harder_course_is_rougher(kind: str) -> None:
    relief = [made(kind, d).surface.relief for d in (0.0, 0.25, 0.5, 1.0)]
    assert relief == sorted(relief)
    assert relief[-1] > 2.5 * relief[0]


@pytest.mark.parametrize("kind", KINDS)
def test_the_line_from_start_to_goal_is_barred_from_the_middle_difficulty_on(kind: str) -> None:
    barred = 0
    for seed in range(10):
        terrain = made(kind, 0.5, seed)
        free = terrain.world().traversable(clearance=0.4, max_slope=math.radians(25)).free
        a, b = (np.array((pose.x, pose.y)) for pose in (terrain.start, terrain.goal))
        cells = (
            terrain.world()
            .traversable(clearance=0.4, max_slope=0.4)
            .cells(a + np.linspace(0, 1, 300)[:, None] * (b - a))
        )
        barred += not free[cells[:, 0], cells[:, 1]].all()
    assert barred >= 9


def test_the_seed_decides() -> None:
    for kind in KINDS:
        assert np.array_equal(made(kind, 0.7).heights, made(kind, 0.7).heights)
        assert not np.array_equal(made(kind, 0.7).heights, made(kind, 0.7, seed=2).heights)


def test_a_scale_scales_all_lengths() -> None:
    one, half = made("craters", 0.6), made("craters", 0.6, scale=0.5)
    assert half.heights == pytest.approx(0.5 * one.heights, abs=1e-6)
    assert half.surface.size == pytest.approx(np.multiply(one.surface.size, 0.5))
    assert half.route == pytest.approx(0.5 * one.route)
    assert (half.start.x, half.start.yaw) == pytest.approx((one.start.x / 2, one.start.yaw))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("scale", "steepness"), [(0.24, 0.71), (0.53, 1.79)])
def test_courses_of_any_scale_fit_their_height_range(kind: str, scale: float, steepness: float) -> None:
    low, high = scaled_height_range(scale, steepness)
    for seed in range(3):
        course = generate(kind, 1.0, np.random.default_rng(seed), scale=scale, steepness=steepness)
        assert low <= course.heights.min() < course.heights.max() <= high
    if kind == "mazes":
        # Seen by a lidar that is mounted high above a small robot.
        assert course.heights.max() > 0.45


@pytest.mark.parametrize(
    ("kind", "difficulty", "scale", "message"),
    [
        ("hill", 0.5, 1.0, "unknown kind of terrain 'hill'"),
        ("waves", 1.5, 1.0, r"difficulty of a terrain must be within \[0, 1\], got 1.5"),
        ("waves", math.nan, 1.0, r"difficulty of a terrain must be within \[0, 1\], got nan"),
        ("waves", 0.5, 0.0, "scale of a terrain must be a finite number above 0, got 0"),
    ],
)
def test_bad_arguments_are_named(kind: str, difficulty: float, scale: float, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        made(kind, difficulty, scale=scale)


def test_natural_terrains_are_seeded_and_rocks_stand_on_them() -> None:
    for make in NATURAL_TERRAINS.values():
        z = make(np.random.default_rng(3))
        assert z.shape == (257, 257)
        assert np.array_equal(z, make(np.random.default_rng(3)))
    rocks = with_rocks(np.random.default_rng(3), np.zeros((257, 257)))
    assert 0.4 < rocks.max() < 2.4
    assert 0.001 < np.mean(rocks > 0) < 0.02


@pytest.mark.parametrize("seed", range(8))
def test_a_robot_can_reach_nearly_all_of_the_floor(seed: int) -> None:
    plan = floor_plan(np.random.default_rng(seed))
    world = World("plan", LaserMap(plan.surface, plan.walls))
    free = world.traversable(clearance=0.31 + 0.15, max_slope=0.3)
    _, _, stats, _ = cv2.connectedComponentsWithStats(free.free.astype(np.uint8), connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    assert areas.max() >= 0.97 * areas.sum()
    assert areas.max() * 0.1**2 > 0.5 * SIZE[0] * SIZE[1]


def test_a_building_is_closed_and_divided() -> None:
    walls = floor_plan(np.random.default_rng(2)).walls
    assert walls.shape == (round(SIZE[1] / CELL), round(SIZE[0] / CELL))
    assert walls.solid[[0, -1], :].all()
    assert walls.solid[:, [0, -1]].all()
    assert 0.03 < walls.solid.mean() < 0.2
