"""The quadrotor hovers, steps, follows terrain and meets walls."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from lirs_envs.robots.robot import Robot, Twist, Waypoint, make_robot
from lirs_envs.simulation import Simulation
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World
from tests.kit import started

TICK = 0.04


@pytest.fixture
def robot() -> Robot:
    return make_robot("quadrotor")


def simulation(world: World, robot: Robot, start: Pose2 | None = None) -> Simulation:
    return started(world, start, robot=robot, lidar="lms111")


def test_hovers_within_five_centimeters(plane: World, robot: Robot) -> None:
    sim = simulation(plane, robot, Pose2(1.0, 2.0, 0.5))
    for k in range(375):
        if k == 125:
            sim.body.data.qvel[:6] += (0.3, -0.2, 0.2, 0.5, -0.5, 0.5)  # a gust
        sim.advance(Twist())
        T = sim.pose()
        away = math.dist(T.position, (1.0, 2.0, 1.0))
        assert away < (0.25 if 125 <= k < 250 else 0.05)
    assert pytest.approx(0.5, abs=0.02) == sim.pose().yaw


@pytest.mark.parametrize(
    "goal", [Waypoint(2, 0, 1), Waypoint(0, -2, 1), Waypoint(0, 0, 3), Waypoint(1.2, 1.2, 2.06, 1.5)]
)
def test_a_step_of_two_meters_in_three_seconds(goal: Waypoint, plane: World, robot: Robot) -> None:
    sim = simulation(plane, robot)
    start, end, along = np.array((0, 0, 1.0)), np.array((goal.x, goal.y, goal.z)), []
    for k in range(125):
        sim.advance(goal)
        p = sim.pose().position
        along.append((p - start) @ (end - start) / 4)
        if k >= 74:
            assert np.linalg.norm(p - end) < 0.05
        assert not sim.find_tipped()[0]
    assert np.linalg.norm(end - start) == pytest.approx(2, abs=0.02)
    assert max(along) < 1.2
    assert along[10] > 0.02
    assert sim.pose().yaw == pytest.approx(goal.yaw, abs=0.02)


def test_commanded_is_flown(plane: World, robot: Robot) -> None:
    sim = simulation(plane, robot)
    for command in (Twist(2.0), Twist(-2.0), Twist(0.0, 3.0), Twist(1.0, 0.5), Twist(8.0)):
        sim.reset(Pose2(0.0 if command.v < 5 else -9.0, 0.0))
        for _ in range(25 if command.v > 5 else 50):
            sim.advance(command)
        distance = turned = 0.0
        for _ in range(10):
            before = sim.pose().to_pose2()
            sim.advance(command)
            moved = before.inverse() @ sim.pose().to_pose2()
            distance, turned = distance + moved.x, turned + moved.yaw
        assert distance / (10 * TICK) == pytest.approx(command.v, abs=max(0.05 * abs(command.v), 0.02))
        assert turned / (10 * TICK) == pytest.approx(command.omega, abs=max(0.05 * abs(command.omega), 0.01))


def test_follows_terrain_at_three_meters_a_second(make_world: Callable[..., World], robot: Robot) -> None:
    world = make_world(lambda x, y: 1.5 * np.sin(x / 1.5) * np.cos(y / 2), nodes=401)
    sim = simulation(world, robot)
    heights, speeds = [], []
    for _ in range(125):
        sim.advance(Twist(3.0))
        T = sim.pose()
        heights.append(T.z - float(world.surface.height_at(T.x, T.y)))
        speeds.append(math.hypot(*sim.body.data.qvel[:2]))
    assert min(heights) > 0.4
    assert max(heights) < 2.5
    assert np.mean(speeds[40:]) == pytest.approx(3.0, rel=0.05)
    assert sim.collisions.body_contacts == 0
    assert sim.replay().T_world_base == sim.pose()
    assert sim.controls.shape == (125 * len(sim.body.substeps), 4)


def test_odometry_and_determinism(plane: World, robot: Robot) -> None:
    ends = []
    for seed in (1, 1, 2):
        sim = started(plane, Pose2(-3.0, 0.0, 0.4), robot=robot, lidar="lms111", seed=seed)
        T_world_odom = sim.pose().to_pose2()
        for k in range(60):
            seen = sim.advance(Twist(1.0, 0.4 * math.sin(k / 20)))
        guess = T_world_odom @ seen.odometry
        assert guess.distance(sim.pose().to_pose2()) < 0.06 * 2.4
        ends.append((seen.odometry, seen.scan.ranges.tobytes()))
    assert ends[0] == ends[1] != ends[2]
