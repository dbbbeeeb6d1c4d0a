"""Lidars with rings: clouds of a sweep, and the planar scan among them."""

import math

import numpy as np
import pytest

from lirs_envs.lidar.lidar import Lidar, Velocity, moved_frames
from lirs_envs.lidar.noise import LidarNoise, lidar_noise
from lirs_envs.lidar.presets import LIDARS, RING_LIDARS
from lirs_envs.robots.robot import Robot, Twist
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import Prop, SimulationConfig
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan, PointCloud
from lirs_wct.world import World
from tests.kit import started
from tests.lirs_envs.lidar.room import rings, room

MOUNT = Pose3.from_rpy(0.2, 0.05, 0.3, 0.02, -0.03, 0.4)
T_WORLD_BASE = Pose3.from_rpy(0.5, -0.4, 0.2, 0.05, -0.02, 1.0)
AT_REST = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
MOTION = ((1.2, 0.3, 0.05), (0.1, -0.2, 1.5))


def sweep(
    name: str, velocity: Velocity | None = None, noise: LidarNoise | None = None, *, rolling: bool = False
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


@pytest.mark.parametrize("name", RING_LIDARS)
def test_points_lie_on_floor_and_walls(name: str) -> None:
    _, cloud = sweep(name)
    world = (T_WORLD_BASE @ cloud.T_base_laser).apply(cloud.xyz)
    assert len(cloud) > 0.5 * LIDARS[name].rings * LIDARS[name].beams
    assert off_the_room(world).max() < 1e-4
    assert {int(ring) for ring in cloud.ring} == set(range(LIDARS[name].rings))
    elevation = np.arcsin(cloud.xyz[:, 2] / np.linalg.norm(cloud.xyz, axis=1))
    np.testing.assert_allclose(elevation, np.array(LIDARS[name].elevations)[cloud.ring], atol=1e-5)


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
    R, p = moved_frames(cloud.time, *MOTION)
    still = np.einsum("nij,nj->ni", R, in_base) + p
    assert off_the_room(T_WORLD_BASE.apply(still)).max() < 1e-3
    at_rest, instant = sweep("vlp16", AT_REST, rolling=True)[1], sweep("vlp16")[1]
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
