"""Walkers: where they walk, that they are seen and touched, and that they come again."""

import math
from typing import Any

import cv2
import mujoco
import numpy as np
import pytest

from lirs_envs.lidar.obstacle_rays import meet_walkers
from lirs_envs.lidar.ray_casting import mujoco_hits
from lirs_envs.robots.robot import Robot, Twist
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import Prop, SimulationConfig
from lirs_envs.walkers import (
    GAP,
    HALF_LENGTH,
    HEIGHT,
    RADIUS,
    TOUCHABLE,
    WALKER_GROUP,
    Walkers,
    walkable_ground,
)
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import Terrain
from lirs_wct.world import World
from tests.kit import started

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def simulation(world: World, robot: Robot, actors: int = 20, **config: Any) -> Simulation:
    return started(world, robot=robot, actors=actors, noise=SensorNoise(lidar="none"), seed=3, **config)


def walker_ranges(centers: Array, origins: Array, directions: Array, max_range: float) -> Array:
    nothing = np.full(len(directions), np.inf)
    nearest, met = np.empty(len(directions)), np.empty(len(directions), np.bool_)
    meet_walkers(centers, origins.reshape(-1, 3), directions, max_range, nothing, nearest, met)
    assert np.array_equal(met, np.isfinite(nearest))
    return nearest


def walked(walkers: Walkers, seconds: float, dt: float = 0.02) -> Array:
    """Middles (steps, n, 3) while the robot is far away."""
    steps = []
    for _ in range(round(seconds / dt)):
        walkers.advance(dt, 1e3, 1e3)
        steps.append(walkers.centers.copy())
    return np.array(steps)


def test_walkers_keep_to_free_ground_at_constant_speed(rough: World, husky: Robot) -> None:
    walkers = Walkers(rough, 30, husky.radius, props=[(4.0, 4.0, 0.5)])
    walkers.reset(Pose2(), np.random.default_rng(5))
    path, dt = walked(walkers, 60.0), 0.02
    ground = walkable_ground(rough)
    cells = ground.cells(path[..., :2])
    free = ground.free[cells[..., 0], cells[..., 1]]
    # A leg is looked at each 5 cm, so that it may cut the corner of a cell.
    assert free.mean() > 0.999
    near = cv2.dilate(ground.free.astype(np.uint8), np.ones((3, 3), np.uint8))
    assert near[cells[..., 0], cells[..., 1]].all()
    assert path[..., 2] == pytest.approx(
        rough.surface.height_at(path[..., 0], path[..., 1]) + HEIGHT / 2, abs=1e-6
    )
    assert (np.hypot(path[..., 0], path[..., 1]) > husky.radius + 1.0).all()
    assert (np.hypot(path[..., 0] - 4, path[..., 1] - 4) > 0.5).all()
    speed = np.hypot(*np.moveaxis(np.diff(path[..., :2], axis=0), 2, 0)) / dt
    usual = np.median(speed, axis=0)
    assert ((usual > 0.49) & (usual < 1.51)).all()
    assert usual.max() - usual.min() > 0.5
    # Slower only in the step in which a walker turns.
    assert np.mean(np.abs(speed - usual) < 1e-6) > 0.99
    assert (speed < usual + 1e-6).all()
    # They go somewhere, and turn at way points.
    assert (np.ptp(path[..., :2], axis=0).max(axis=1) > 2.0).all()


def test_walkers_wait_for_the_robot_and_turn_back(plane: World, husky: Robot) -> None:
    walkers = Walkers(plane, 200, husky.radius)
    walkers.reset(Pose2(), np.random.default_rng(5))
    robot, near, still = np.array((3.0, -2.0)), 0, 0
    begun = np.hypot(*(walkers.centers[:, :2] - robot).T)
    clear = begun > husky.radius + RADIUS + GAP
    for _ in range(3000):
        before = walkers.centers.copy()
        walkers.advance(0.02, *robot)
        distance = np.hypot(*(walkers.centers[:, :2] - robot).T)[clear]
        assert (distance >= husky.radius + RADIUS + GAP - 1e-9).all()
        near += int((distance < husky.radius + RADIUS + GAP + 0.05).sum())
        still += int((walkers.centers == before).all(axis=1)[clear].sum())
    assert near > 100
    # Waiting has an end.
    assert 0 < still < 0.1 * 3000 * clear.sum()


def test_rays_meet_capsules_where_mujoco_s_do(rough: World, husky: Robot) -> None:
    sim = simulation(rough, husky, actors=40, rays="mujoco")
    centers, rng = sim.walkers(), np.random.default_rng(1)
    sim.advance(Twist(0.5, 0.1))
    sim.body.data.mocap_pos[:] = centers
    mujoco.mj_kinematics(sim.body.model, sim.body.data)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    middle = rng.integers(len(centers), size=4000)
    sizes = rng.uniform(-1, 1, (4000, 3)) * (1.5 * RADIUS, 1.5 * RADIUS, 1.2 * (HALF_LENGTH + RADIUS))
    origins = centers[middle] + sizes - 3.0 * directions * (rng.random(4000) < 0.9)[:, None]
    ours = walker_ranges(centers, origins, directions, math.inf)
    theirs = mujoco_hits(
        sim.body.model, sim.body.data, origins, directions, math.inf, groups=(WALKER_GROUP,)
    )[0]
    assert np.isfinite(ours).mean() > 0.4
    assert np.mean(np.isfinite(ours) == np.isfinite(theirs)) > 0.999
    both = np.isfinite(ours) & np.isfinite(theirs)
    assert ours[both] == pytest.approx(theirs[both], abs=1e-9)
    assert (walker_ranges(centers, origins, directions, 1.0)[ours > 1.0] == np.inf).all()
    # All from one origin, ordered as a lidar's or not, level or not: as each ray by itself.
    turn = np.linspace(-4, 4, 1001)
    level = np.column_stack((np.cos(turn), np.sin(turn), np.zeros(1001)))
    for fan in (directions, level, level @ np.linalg.qr(rng.normal(size=(3, 3)))[0]):
        for origin in (origins[0], origins[1], centers[0], (0.0, 0.0, 1.0)):
            each = np.tile(origin, (len(fan), 1))
            one = walker_ranges(centers, np.array(origin), fan, 15.0)
            assert np.array_equal(one, walker_ranges(centers, each, fan, 15.0))
            by_mujoco, _, _ = mujoco_hits(
                sim.body.model, sim.body.data, origin, fan, 15.0, groups=(WALKER_GROUP,)
            )
            assert np.mean(np.isfinite(one) == np.isfinite(by_mujoco)) > 0.99


def test_both_rays_see_the_same_walkers(rough: World, husky: Robot) -> None:
    builtin, by_mujoco = (simulation(rough, husky, 40, rays=rays) for rays in ("builtin", "mujoco"))
    seen = 0
    for _ in range(3):
        ours, theirs = builtin.advance(Twist(0.5, 0.3)).scan, by_mujoco.advance(Twist(0.5, 0.3)).scan
        assert builtin.walker_beams is not None
        met = builtin.walker_beams
        seen += int(met.sum())
        assert np.mean(met == by_mujoco.walker_beams) > 0.99
        both = met & by_mujoco.walker_beams
        assert ours.ranges[both] == pytest.approx(theirs.ranges[both], abs=1e-5)
    assert seen > 30


def test_a_robot_that_drives_into_a_walker_touches_it(plane: World, husky: Robot) -> None:
    sim = simulation(plane, husky, 60)
    for _ in range(3000):
        here = sim.pose().to_pose2()
        offset = sim.walkers()[:, :2] - (here.x, here.y)
        x, y = offset[np.argmin(np.hypot(*offset.T))]
        error = math.remainder(math.atan2(y, x) - here.yaw, math.tau)
        sim.advance(Twist(1.0 if abs(error) < 0.5 else 0.0, 2 * error))
        if sim.collisions.body_contacts:
            break
    assert sim.collisions.body_contacts == 1
    assert sim.collisions.max_penetration < 0.05
    distance = np.hypot(*(sim.walkers()[:, :2] - (sim.pose().x, sim.pose().y)).T)
    assert distance.min() < husky.radius + RADIUS


def test_walkers_leave_ground_and_fixed_props_alone(rough: World, husky: Robot) -> None:
    box = Prop(shape="box", size=(0.3, 0.3, 0.3), place=Pose2(2.0, 2.0))
    sim = simulation(rough, husky, 40, props=(box,))
    for _ in range(3):
        sim.reset()
        for _ in range(10):
            sim.advance(Twist())
        names = [sim.body.model.geom(int(g)).name for g in sim.body.data.contact.geom.ravel()]
        assert names
        assert not any(name.startswith("walker") for name in names)


def test_the_nearest_walkers_have_the_bodies(rough: World, husky: Robot) -> None:
    sim = simulation(rough, husky, 40)
    for _ in range(20):
        sim.advance(Twist(0.8, 0.2))
    bodies = sim.body.data.mocap_pos
    assert len(bodies) == TOUCHABLE
    far = np.hypot(*(sim.walkers()[:, :2] - (sim.pose().x, sim.pose().y)).T)
    assert np.array_equal(bodies[:3], sim.walkers()[np.argsort(far)[:3]])
    few = simulation(rough, husky, 3)
    assert sorted(few.body.data.mocap_pos.tolist()) == sorted(few.walkers().tolist())


def driven(sim: Simulation, ticks: int = 10) -> bytes:
    scans = [sim.advance(Twist(0.8, 0.4)).scan.ranges.tobytes() for _ in range(ticks)]
    return b"".join(scans) + sim.body.state().tobytes() + sim.walkers().tobytes()


def test_the_seed_decides_and_a_reset_repeats(rough: World, husky: Robot) -> None:
    sim, other = simulation(rough, husky), simulation(rough, husky)
    sim.reset(seed=1)
    first = driven(sim)
    other.reset(seed=1)
    assert driven(other) == first
    other.reset(seed=2)
    assert driven(other) != first
    other.reset(seed=1)
    assert driven(other) == first


def test_bad_numbers_and_full_worlds_are_named(plane: World, husky: Robot) -> None:
    for bad in (-1, 1.5, True, "3"):
        with pytest.raises(ConfigError, match="actors must be a whole number at least 0"):
            SimulationConfig(robot=husky, actors=bad)  # type: ignore[arg-type]
    steep = np.tile(np.arange(0, 60, 1, dtype=np.float32), (60, 1))
    world = World("steep", Terrain(HeightField.centered(steep, (0.1, 0.1))))
    with pytest.raises(SimulationError, match="steep: no ground is free for walkers"):
        Walkers(world, 3, 0.5)
    walkers = Walkers(plane, 3, 50.0)
    with pytest.raises(SimulationError, match="no ground is free for walkers besides the robot"):
        walkers.reset(Pose2(), np.random.default_rng(0))
