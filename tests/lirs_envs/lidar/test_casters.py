"""MuJoCo's own rays in place of the builtin ones: the same world, the same robot, the same noise."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from lirs_envs.lidar.obstacle_rays import GROUND, intensities
from lirs_envs.lidar.ray_casting import RayCaster
from lirs_envs.robots.robot import Robot, Twist
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import Prop, SimulationConfig, StaticRobot
from lirs_wct.geometry import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World
from tests.kit import started

Array = np.ndarray


@pytest.fixture(scope="module")
def hills(make_world: Callable[..., World]) -> World:
    """Smooth enough for a coarser contact grid, with a rim that most beams meet."""

    def z(x: Array, y: Array) -> Array:
        rim = np.clip(np.maximum(abs(x), abs(y)) - 4.0, 0.0, 0.5) * 3
        return 0.15 * np.sin(x) * np.cos(y / 1.3) + rim

    return make_world(z, nodes=241, cell=0.05)


def scans(world: World, robot: Robot, **options: object) -> tuple[Array, str]:
    config = SimulationConfig(robot=robot, lidar="urg04lx", **options)  # type: ignore[arg-type]
    sim = Simulation(world, config)
    seen = [sim.reset().scan.ranges]
    seen += [sim.advance(Twist(0.4, 0.5)).scan.ranges for _ in range(3)]
    return np.array(seen), repr(sim.pose())


@pytest.mark.parametrize(("contact", "rolling"), [("hfield", False), ("mesh", True), ("prisms", True)])
def test_both_rays_agree(hills: World, husky: Robot, contact: str, rolling: bool) -> None:
    noise = SensorNoise(lidar="none", rolling_scan=rolling)
    builtin, end = scans(hills, husky, contact_geometry=contact, noise=noise)
    theirs, other_end = scans(hills, husky, contact_geometry=contact, noise=noise, rays="mujoco")
    assert end == other_end, "what is touched is the same"
    finite = np.isfinite(builtin)
    assert 0.3 < finite.mean() < 1
    np.testing.assert_allclose(theirs[finite], builtin[finite], atol=1e-3)
    assert (builtin[~finite] == theirs[~finite]).all()


def test_walls_props_and_static_robots(walled: World, husky: Robot) -> None:
    props = (
        Prop(shape="sphere", size=(0.5,), place=Pose2(1.8, 1.0)),
        StaticRobot(husky, Pose2(-1.8, 0.3, 1.0)),
    )
    for contact in ("hfield", "mesh"):
        builtin, theirs = (
            scans(
                walled,
                husky,
                contact_geometry=contact,
                props=props,
                noise=SensorNoise(lidar="none"),
                rays=rays,
            )[0]
            for rays in ("builtin", "mujoco")
        )
        np.testing.assert_allclose(theirs, builtin, atol=1e-3)
        assert 0.1 < np.isfinite(builtin).mean() < 1


@pytest.mark.parametrize("rolling", [False, True])
def test_intensities_agree_with_the_normals_of_mujoco(walled: World, husky: Robot, rolling: bool) -> None:
    """Ground, walls, a prop and walkers: other code for each in the builtin rays."""
    props = (Prop(shape="sphere", size=(0.5,), place=Pose2(1.8, 1.0)),)
    noise = SensorNoise(lidar="none", rolling_scan=rolling)
    seen = []
    for rays in ("builtin", "mujoco"):
        sim = started(walled, robot=husky, lidar="vlp16", props=props, actors=4, noise=noise, rays=rays)
        cloud = sim.advance(Twist(0.4, 0.5)).cloud
        assert cloud.intensity is not None
        seen.append((cloud.ring.astype(int) * 1800 + cloud.column, cloud.intensity, sim.walker_points))
    (beams, ours, walkers), (their_beams, theirs, _) = seen
    assert walkers.sum() > 20
    both, k, m = np.intersect1d(beams, their_beams, return_indices=True)
    assert len(both) > 0.99 * len(beams)
    # A beam at an edge may meet either face.
    assert (np.abs(ours[k] - theirs[m]) < 0.5).mean() > 0.995
    assert ours.std() > 1


def test_intensity_follows_the_lidar_equation() -> None:
    ground = HeightField.centered(np.zeros((401, 401), np.float32), (0.1, 0.1))
    down = math.radians(30)
    d = np.array([(math.cos(down), 0, -math.sin(down))])
    for height in (1.0, 8.0):
        ranges, reflectances = RayCaster(ground).hits(np.array((-15.0, 0.0, height)), d, 100.0)
        assert ranges[0] == pytest.approx(2 * height)
        loss = min(1.0, (10 / (2 * height)) ** 2)
        (intensity,) = intensities(ranges.astype(np.float32), reflectances)
        assert intensity == pytest.approx(255 * GROUND * 0.5 * loss, rel=1e-5)
