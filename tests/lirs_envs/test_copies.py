"""A copy of a simulation in mid-run goes on bit for bit, and leaves its original alone."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lirs_envs.lidar.ray_casting import MeshCaster
from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import Prop
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World
from tests.kit import started
from tests.lirs_envs.lidar.room import rings


def through_pickle(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


COPIES = pytest.mark.parametrize("copied", [copy.deepcopy, through_pickle], ids=["deepcopy", "pickle"])


def driven(sim: Simulation, seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    told = []
    for _ in range(12):
        o = sim.advance(Twist(rng.uniform(-1, 1), rng.uniform(-2, 2)))
        told.append(
            o.scan.ranges.tobytes() + repr((o.odometry, o.imu, o.scan.stamp, sim.collisions)).encode()
        )
    return b"".join(told) + repr((sim.pose(), sim.time())).encode() + sim.body.state().tobytes()


def checked(sim: Simulation, copied: Callable[[Simulation], Simulation]) -> None:
    driven(sim, 1)
    again = copied(sim)
    before = sim.body.state().tobytes()
    told = driven(again, 2)
    assert sim.body.state().tobytes() == before, "the copy drove the original"
    assert driven(sim, 2) == told
    assert again.pose() == sim.pose()
    assert sim.replay().T_world_base == again.replay().T_world_base


@COPIES
@pytest.mark.parametrize("robot", ["husky", "jackal", "quadrotor"])
def test_a_copy_goes_on_bit_for_bit(rough: World, robot: str, copied: Callable[[Any], Any]) -> None:
    sim = started(
        rough,
        robot=make_robot(robot),
        noise=SensorNoise(odometry=OdometryConfig(method="ekf"), lidar="datasheet", rolling_scan=True),
        seed=3,
    )
    checked(sim, copied)


@COPIES
def test_props_and_mujoco_s_rays_follow_the_copy(walled: World, copied: Callable[[Any], Any]) -> None:
    ball = Prop(shape="sphere", size=(0.3,), place=Pose2(1.5, 0.0), mass=5.0)
    sim = started(walled, robot=make_robot("husky"), props=(ball,), rays="mujoco")
    checked(sim, copied)


@pytest.mark.slow
def test_rays_on_a_true_mesh_follow_the_copy(make_world: Callable[..., World]) -> None:
    pytest.importorskip("embreex")
    caster = MeshCaster(make_world(lambda x, y: 3.0 * (np.hypot(x, y) > 1.5), nodes=41).mesh)
    rays = (np.array((0.0, 0.0, 1.5)), rings(1, 90, -0.2, -0.2), 30.0)
    assert np.isfinite(caster.ranges(*rays)).all()
    assert (through_pickle(caster).ranges(*rays) == caster.ranges(*rays)).all()
    assert copy.deepcopy(caster) is caster
