"""Lidars with rings: clouds of a sweep, and the planar scan among them."""

import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from lirs_envs.lidar.lidar import BaseVelocity, Lidar, moved_frames
from lirs_envs.lidar.presets import LIDARS, RING_LIDARS, LidarNoise, LidarPreset, lidar_noise
from lirs_envs.props import Prop
from lirs_envs.robots.robot import Robot, Twist
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan, PointCloud
from lirs_wct.world import World
from tests.kit import started
from tests.lirs_envs.lidar.room import rings, room

MOUNT = Pose3.from_rpy(0.2, 0.05, 0.3, 0.02, -0.03, 0.4)
T_WORLD_BASE = Pose3.from_rpy(0.5, -0.4, 0.2, 0.05, -0.02, 1.0)
MOTION = BaseVelocity((1.2, 0.3, 0.05), (0.1, -0.2, 1.5))


def sweep(
    name: str, velocity: BaseVelocity | None = None, noise: LidarNoise | None = None, *, rolling: bool = False
) -> tuple[LaserScan, PointCloud]:
    lidar = Lidar(
        LIDARS[name], room(), MOUNT, np.random.default_rng(3), noise or LidarNoise(), rolling_scan=rolling
    )
    return lidar.sweep(T_WORLD_BASE, 3.0, velocity)


def off_the_room(points: np.ndarray) -> np.ndarray:
    """How far points in the world lie from floor and inner walls, whatever is nearer, meters."""
    x, y, z = points.T
    wall = np.minimum(np.abs(np.abs(x) - 4.0), np.abs(np.abs(y) - 3.0))
    return np.minimum(wall, np.abs(z))


@pytest.mark.parametrize(
    ("name", "count", "columns", "lowest", "horizon"),
    [("vlp16", 16, 1800, -15.0, 1.0), ("os1_32", 32, 1024, -22.5, 22.5 / 31)],
)
def test_presets_are_the_devices(name: str, count: int, columns: int, lowest: float, horizon: float) -> None:
    lidar = LIDARS[name]
    assert (lidar.rings, lidar.beams, lidar.rate) == (count, columns, 10.0)
    elevations = np.degrees(lidar.elevations)
    assert elevations[[0, -1]].tolist() == pytest.approx([lowest, -lowest])
    assert np.diff(elevations) == pytest.approx(np.full(count - 1, -2 * lowest / (count - 1)))
    assert elevations[lidar.horizon] == pytest.approx(horizon), "of two rings as near the upper one"
    assert lidar_noise(lidar, "datasheet").quantization > 0, "has a row of its own in the data sheets"
    assert name in RING_LIDARS


def test_a_planar_lidar_is_one_level_ring() -> None:
    lms = LIDARS["lms111"]
    assert (lms.rings, lms.horizon, lms.planar) == (1, 0, lms)
    np.testing.assert_array_equal(lms.all_directions, lms.directions)
    assert not lms.directions[:, 2].any()


@pytest.mark.parametrize("elevations", [(), (0.1, 0.0), (0.0, 0.0), (-2.0, 0.0), (0.0, math.nan)])
def test_elevations_that_do_not_rise_are_refused(elevations: tuple[float, ...]) -> None:
    with pytest.raises(ConfigError, match="elevations of lidar 'lms111' must rise"):
        replace(LIDARS["lms111"], elevations=elevations)


@pytest.mark.parametrize("name", RING_LIDARS)
def test_points_lie_on_floor_and_walls(name: str) -> None:
    _, cloud = sweep(name)
    world = (T_WORLD_BASE @ cloud.T_base_laser).apply(cloud.xyz)
    assert len(cloud) > 0.5 * LIDARS[name].rings * LIDARS[name].beams
    assert off_the_room(world).max() < 1e-4
    assert {int(ring) for ring in cloud.ring} == set(range(LIDARS[name].rings))
    elevation = np.arcsin(cloud.xyz[:, 2] / np.linalg.norm(cloud.xyz, axis=1))
    np.testing.assert_allclose(elevation, np.array(LIDARS[name].elevations)[cloud.ring], atol=1e-5)


def test_the_beams_are_those_of_a_pattern() -> None:
    lidar = LIDARS["vlp16"]
    directions = rings(16, 1800, math.radians(-15), math.radians(15))
    np.testing.assert_allclose(lidar.all_directions, directions, atol=1e-12)
    T = T_WORLD_BASE @ MOUNT
    ranges = room().cast(T.position, directions @ T.rotation.T, lidar.range_max)
    met = (ranges >= lidar.range_min) & (ranges <= lidar.range_max)
    _, cloud = sweep("vlp16")
    np.testing.assert_allclose(cloud.xyz, ranges[met, None] * directions[met], atol=2e-6)


def test_rings_see_props_and_not_their_own_robot(plane: World, husky: Robot) -> None:
    box = Prop(shape="box", size=(0.3, 0.3, 0.5), place=Pose2(3.0, 0.0))
    sim = started(plane, robot=husky, props=(box,))
    T = sim.pose() @ husky.T_base_laser
    directions = rings(9, 720, -1.5, 0.3) @ T.rotation.T
    ranges = sim.casters[0].ranges(T.position, np.ascontiguousarray(directions), 8.0)
    met = np.isfinite(ranges) & (ranges < 8.0)
    points = T.position + ranges[met, None] * directions[met]
    floor = np.abs(points[:, 2]) < 1e-5
    on_box = np.abs(np.maximum(np.abs(points[:, 0] - 3.0), np.abs(points[:, 1])) - 0.3) < 1e-4
    assert (floor | on_box).all(), "nothing of the robot, though beams go down through it"
    assert floor.sum() > 2000
    assert on_box.sum() > 50


@pytest.mark.parametrize("name", RING_LIDARS)
def test_the_planar_scan_is_the_ring_nearest_the_horizon(name: str) -> None:
    scan, cloud = sweep(name, noise=lidar_noise(LIDARS[name], "datasheet"))
    ring = cloud.xyz[cloud.ring == LIDARS[name].horizon]
    assert len(scan.ranges) == LIDARS[name].beams
    np.testing.assert_allclose(np.linalg.norm(ring, axis=1), scan.ranges[scan.hits], rtol=1e-6)
    angles = np.arctan2(ring[:, 1].astype(np.float64), ring[:, 0].astype(np.float64))
    turned = np.remainder(angles - scan.angles[scan.hits] + math.pi, math.tau) - math.pi
    assert np.abs(turned).max() < 1e-6


def test_a_sweep_at_one_instant_has_no_times() -> None:
    scan, cloud = sweep("vlp16", MOTION)
    assert scan.time_increment == 0.0
    assert not cloud.time.any()
    assert not cloud.rolling


def test_each_column_of_a_rolling_sweep_has_its_own_time() -> None:
    scan, cloud = sweep("vlp16", MOTION, rolling=True)
    lidar = LIDARS["vlp16"]
    assert cloud.rolling
    assert scan.time_increment * lidar.beams == pytest.approx(lidar.period)
    assert cloud.time.min() >= 0
    assert cloud.time.max() < lidar.period
    column = np.round(cloud.time / scan.time_increment).astype(int)
    azimuth = np.arctan2(cloud.xyz[:, 1].astype(np.float64), cloud.xyz[:, 0].astype(np.float64))
    off = np.remainder(azimuth - scan.angles[column] + math.pi, math.tau) - math.pi
    assert np.abs(off).max() < 1e-4, "the rings' beams of one angle are cast together"


def test_motion_skews_a_rolling_sweep_and_its_times_undo_it() -> None:
    _, cloud = sweep("vlp16", MOTION, rolling=True)
    in_base = cloud.T_base_laser.apply(cloud.xyz)
    assert off_the_room(T_WORLD_BASE.apply(in_base)).max() > 0.1
    R, p = moved_frames(cloud.time, MOTION.linear, MOTION.angular)
    still = np.einsum("nij,nj->ni", R, in_base) + p
    assert off_the_room(T_WORLD_BASE.apply(still)).max() < 1e-3
    at_rest, instant = sweep("vlp16", BaseVelocity(), rolling=True)[1], sweep("vlp16")[1]
    np.testing.assert_array_equal(at_rest.xyz, instant.xyz)


def test_a_simulation_observes_clouds_where_there_are_rings(rough: World, husky: Robot) -> None:
    noise = SensorNoise(lidar="none", rolling_scan=True)
    sim = started(rough, robot=husky, lidar="vlp16", noise=noise, seed=1)
    observation = sim.advance(Twist(0.5, 0.2))
    cloud = observation.cloud
    assert (cloud.stamp, cloud.T_base_laser) == (observation.scan.stamp, husky.T_base_laser)
    assert cloud.rolling
    first = cloud.time < 1e-3
    world = (sim.pose() @ cloud.T_base_laser).apply(cloud.xyz[first])
    height = rough.surface.height_at(world[:, 0], world[:, 1])
    gentle = np.abs(world[:, 2] - height) < 0.02
    assert gentle.mean() > 0.6, "most points lie on the ground; the others on steep faces"
    planar = Simulation(rough, SimulationConfig(robot=husky), seed=1)
    assert planar.reset().cloud is None


def test_points_on_walkers_are_known(rough: World, husky: Robot) -> None:
    noise = SensorNoise(lidar="none")
    sims = [
        Simulation(rough, SimulationConfig(robot=husky, lidar="vlp16", noise=noise, actors=n), seed=1)
        for n in (0, 12)
    ]
    for sim in sims:
        sim.reset()
    still, walked = (sim.advance(Twist(0.0, 0.0)).cloud for sim in sims)
    met = sims[1].walker_points
    assert sims[0].walker_points is None
    assert met.shape == (len(walked),)
    assert met.any()
    beams = sims[1].walker_beams
    assert beams.shape == (LIDARS["vlp16"].beams,)
    ground = {tuple(point) for point in still.xyz.tolist()}
    assert all(tuple(point) in ground for point in walked.xyz[~met].tolist())
    assert not any(tuple(point) in ground for point in walked.xyz[met].tolist())


def test_an_environment_observes_the_planar_scan_of_a_ring_lidar() -> None:
    env = gym.make(
        "LIRS/Navigation-v1", world="simple", robot="husky", lidar="vlp16", noise="none", observe=["scan"]
    )
    observation, _ = env.reset(seed=1)
    scan = observation["scan"] if isinstance(observation, dict) else observation
    assert scan.shape == (LIDARS["vlp16"].beams,)
    env.close()


def test_a_ring_preset_of_ones_own_is_cast(husky: Robot) -> None:
    dome = LidarPreset(
        name="dome", beams=90, fov=math.tau, rate=10, range_min=0.1, range_max=30, elevations=(-0.5, 0.0, 0.5)
    )
    scan, cloud = Lidar(dome, room(), MOUNT, np.random.default_rng(0)).sweep(Pose3(), 0.0)
    assert dome.horizon == 1
    assert len(scan.ranges) == 90
    assert len(cloud) <= 270
