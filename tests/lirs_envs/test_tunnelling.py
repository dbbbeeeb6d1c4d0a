"""No robot ever sinks into ground or walls, wherever it is driven. The long matrix: `lirs-wct collide`."""

import math
from functools import lru_cache

import mujoco
import numpy as np
import pytest

from lirs_envs.robots.robot import ROBOTS, Twist, make_robot
from lirs_envs.simulation import Simulation
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.ground import Terrain
from lirs_wct.sources.build import build_world
from lirs_wct.sources.bundled import RECIPES
from lirs_wct.world import World
from tests.kit import started

GROUND = [name for name, robot in ROBOTS.items() if not robot.flies]
IMPACT = 0.010
"""Meters of penetration a meter a second of impact."""


@lru_cache(maxsize=4)
def world_of(name: str) -> World:
    return build_world(name)


def drive_at_random(sim: Simulation, seconds: float, seed: int = 4) -> float:
    """Drive at full speed, turn at random, back off from obstacles; return the meters driven."""
    rng, robot = np.random.default_rng(seed), sim.robot
    driven, last = 0.0, sim.pose()
    for k in range(math.ceil(seconds / sim.period)):
        if k % 40 == 0:
            ahead, turn = rng.choice((-1.0, 1.0, 1.0)), rng.uniform(-1, 1) * rng.integers(2)
        sim.advance(Twist(ahead * robot.max_speed, turn * robot.max_turn_rate))
        here = sim.pose()
        driven, last = driven + math.hypot(here.x - last.x, here.y - last.y), here
        if sim.off_world()[0]:
            break
        ground = float(sim.worlds[0].surface.height_at(here.x, here.y))
        # The center of the body lies above base_link where a robot stands; a lying one may dip it by a rim.
        assert here.z + 0.05 > ground
        assert np.abs(sim.body.data.qvel[:3]).max() < robot.max_speed + 7, "it was thrown"
        if sim.find_tipped()[0]:
            break
    return driven


@pytest.mark.parametrize("name", GROUND)
@pytest.mark.parametrize(
    "where", ["simple", *(pytest.param(name, marks=pytest.mark.slow) for name in RECIPES if name != "simple")]
)
def test_random_driving_never_tunnels(where: str, name: str) -> None:
    sim = started(world_of(where), robot=make_robot(name), lidar="lms111")
    driven = drive_at_random(sim, 6.0)
    found = sim.collisions
    assert driven > 0.3 * sim.robot.max_speed
    assert found.penetration_p999 <= 0.010
    assert found.max_penetration <= IMPACT * max(1.0, 2 * sim.robot.max_speed)


@pytest.mark.parametrize("name", [pytest.param("husky", marks=pytest.mark.slow), "jackal"])
def test_against_steep_blocks(name: str, rough: World) -> None:
    sim = started(rough, robot=make_robot(name), lidar="lms111")
    assert drive_at_random(sim, 60.0) > 5
    found = sim.collisions
    assert found.body_contacts > 0 or sim.find_tipped()[0], (
        "it never met an obstacle, so that nothing was tested"
    )
    assert found.penetration_p999 <= 0.010
    assert found.max_penetration <= IMPACT * max(1.0, 2 * sim.robot.max_speed)


@pytest.mark.parametrize(
    "name",
    [
        "turtlebot2",
        *(pytest.param(f"turtlebot3_{kind}", marks=pytest.mark.slow) for kind in ("burger", "waffle")),
    ],
)
@pytest.mark.parametrize(("nodes_wide", "across"), [(1, 0.0), (1, 0.04), (3, 0.0), (3, 0.1)])
def test_a_turtlebot_on_a_narrow_barrier_stays_or_falls(name: str, nodes_wide: int, across: float) -> None:
    """A ridge of one or three nodes, 0.5 m high; the robot is let go right above it."""
    z = np.zeros((121, 121), np.float32)
    middle = 60
    z[:, middle - nodes_wide // 2 : middle + nodes_wide // 2 + 1] = 0.5
    world = World("barrier", Terrain(HeightField.centered(z, (0.05, 0.05))), spawn_poses=(Pose2(),))
    sim = started(world, Pose2(-1.5, 0.0), robot=make_robot(name), lidar="lms111")
    touched = sim.body.contact.heights(world.surface)
    for yaw in (0.0, 0.8, math.pi / 2):
        sim.body.settle(
            Pose3.from_rpy(across, 0.0, 0.5 + sim.robot.base_height + 0.02, 0, 0, yaw), seconds=0.02
        )
        deepest = 0.0
        for _ in range(1500):
            sim.body.step(1)
            contact = sim.body.data.contact
            deepest = max(deepest, -min(contact.dist.tolist(), default=0.0))
            T = sim.pose()
            # base_link is near the belly's underside, which may graze the ridge while the robot rolls off it.
            assert T.z > float(touched.height_at(T.x, T.y)) - 0.02
        assert deepest <= IMPACT * math.sqrt(2 * 9.81 * 0.5)


@pytest.mark.parametrize("where", ["flat_field", "plane", "walled"])
@pytest.mark.parametrize("name", list(ROBOTS))
def test_contacts_are_as_the_robots_file_says(
    name: str, where: str, request: pytest.FixtureRequest, T_world_wall: Pose2
) -> None:
    """Ground and walls share nothing of their own: stiffness and friction are the robot's alone."""
    start = T_world_wall @ Pose2(2.35 - make_robot(name).radius) if where == "walled" else None
    sim = started(request.getfixturevalue(where), start, robot=make_robot(name), lidar="lms111")
    model, data = sim.body.model, sim.body.data
    if sim.robot.flies:
        data.ctrl[:] = 0.0
        mujoco.mj_step(model, data, 1000)
    for _ in range(50):
        sim.advance(Twist(sim.robot.max_speed / 2))
    touching = data.contact.geom
    assert len(touching) > 0 or sim.robot.flies
    for pair, solref, friction in zip(touching, data.contact.solref, data.contact.friction, strict=True):
        (own,) = (g for g in pair.tolist() if model.geom_bodyid[g] > 0)
        assert solref == pytest.approx(model.geom_solref[own])
        assert friction[0] == pytest.approx(model.geom_friction[own, 0])
        assert model.geom_priority[own] > 0
    assert not model.geom_priority[model.geom_bodyid == 0].any()
