"""Rolling scans: motion distorts them, de-skewing with the true motion restores them."""

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from lirs_envs.lidar.lidar import Lidar, Velocity, moved_frames
from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.lidar.presets import LIDARS, LidarPreset, ring_directions
from lirs_envs.robots.robot import Robot, Twist
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan
from lirs_wct.world import World
from tests.lirs_envs.lidar.room import room

MOUNT = Pose3(0.2, 0.05, 0.3)
SLOW = LidarPreset(name="slow", beams=721, fov=math.tau, rate=5.0, range_min=0.1, range_max=30.0)
AT_REST = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
MOTION = ((1.2, 0.3, 0.0), (0.0, 0.0, 1.5))


def rolling_scan(velocity: Velocity | None, *, rolling: bool = True) -> LaserScan:
    lidar = Lidar(SLOW, room(), MOUNT, np.random.default_rng(0), LidarNoise(), rolling_scan=rolling)
    return lidar.scan(Pose3(0.5, -0.4, 0.2), 3.0, velocity=velocity)


def off_the_walls(points: np.ndarray) -> np.ndarray:
    """Distance of points in the base frame from the room's walls."""
    x, y = points[:, 0] + 0.5, points[:, 1] - 0.4
    return np.minimum(np.abs(np.abs(x) - 4.0), np.abs(np.abs(y) - 3.0))


def deskew(scan: LaserScan, velocity: ArrayLike, rates: ArrayLike) -> np.ndarray:
    """Return (n, 3) beam ends in the base frame at the scan's stamp; NaN without a hit."""
    beams = np.where(scan.hits, scan.ranges, np.nan).astype(np.float64)[:, None] * ring_directions(
        scan.angles
    )
    R, p = moved_frames(scan.time_increment * np.arange(len(beams)), velocity, rates)
    return np.einsum("nij,nj->ni", R, scan.T_base_laser.apply(beams)) + p


def test_a_rolling_scan_takes_the_mirror_s_time() -> None:
    scan = rolling_scan(MOTION)
    assert scan.stamp == 3.0
    assert scan.time_increment * len(scan.ranges) == pytest.approx(SLOW.period)
    lms = Lidar(LIDARS["lms111"], room(), MOUNT, np.random.default_rng(0), rolling_scan=True)
    assert lms.time_increment * 540 == pytest.approx(0.75 * 0.04), "270 of 360 deg"
    assert rolling_scan(MOTION, rolling=False).time_increment == 0.0


def test_motion_distorts_and_de_skewing_undoes_it() -> None:
    scan = rolling_scan(MOTION)
    skewed = deskew(scan, (0, 0, 0), (0, 0, 0))
    assert np.nanmax(off_the_walls(skewed)) > 0.15, "1.2 m/s and 1.5 rad/s for 0.2 s bend the walls"
    assert np.nanmax(off_the_walls(deskew(scan, *MOTION))) < 1e-5
    # At rest, a rolling scan is a scan at one instant.
    np.testing.assert_array_equal(rolling_scan(None).ranges, rolling_scan(AT_REST).ranges)
    np.testing.assert_array_equal(rolling_scan(AT_REST).ranges, rolling_scan(MOTION, rolling=False).ranges)


def test_moved_frames_against_small_steps() -> None:
    v, w = np.array((1.0, -0.4, 0.2)), np.array((0.3, -0.5, 1.1))
    R, p = moved_frames((0.0, 0.7), v, w)
    np.testing.assert_allclose(R[0], np.eye(3))
    n = 20000
    T = Pose3()
    for _ in range(n):
        half = w * 0.35 / n
        T = T @ Pose3.from_arrays(v * 0.7 / n, (1.0, *half))
    np.testing.assert_allclose(p[1], T.position, atol=1e-4)
    np.testing.assert_allclose(R[1], T.rotation, atol=1e-4)
    np.testing.assert_allclose(moved_frames((2.0,), v, (0, 0, 0))[1], [2 * v])


def test_the_simulation_has_rolling_scans(walled: World, husky: Robot) -> None:
    sim = Simulation(
        walled,
        SimulationConfig(robot=husky, noise=SensorNoise(lidar="none", rolling_scan=True), lidar="utm30lx"),
    )
    still = sim.reset().scan
    assert still.time_increment > 0
    for _ in range(40):
        scan = sim.advance(Twist(0.5, 2.0)).scan
    motion = (sim.body.velocity(), sim.body.rates())
    world = sim.pose().apply(deskew(scan, *motion))
    naive = sim.pose().apply(deskew(scan, (0, 0, 0), (0, 0, 0)))
    T_wall_world = Pose2(0.5, -0.3, 0.4).inverse()

    def spread(points: np.ndarray) -> float:
        x = T_wall_world.apply(points[np.isfinite(points[:, 0]), :2])[:, 0]
        return float(np.median(np.abs(x - 3.0)))

    assert spread(world) < 1e-4 < 5e-3 < spread(naive)
