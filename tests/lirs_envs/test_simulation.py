"""The simulation's contract: repeatable, replayable, honest about what it cannot do."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from lirs_envs.lidar.presets import LIDARS
from lirs_envs.robots.robot import Robot, Twist, make_robot
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.sensors import Observation, SensorNoise
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World
from tests.kit import started

SILENT = SensorNoise(
    imu=ImuConfig(
        attitude_sigma=0,
        attitude_bias=0,
        rate_sigma=0,
        rate_bias=0,
        acceleration_sigma=0,
        acceleration_bias=0,
    ),
    odometry=OdometryConfig(scale_sigma=0),
)


def drive(sim: Simulation, ticks: int = 60) -> list[Observation]:
    seen = [sim.reset()]
    rng = np.random.default_rng(1)
    for k in range(ticks):
        if k % 20 == 0:
            command = Twist(rng.uniform(-1, 1), rng.uniform(-2, 2))
        seen.append(sim.advance(command))
    return seen


def fingerprint(seen: list[Observation]) -> bytes:
    return b"".join(o.scan.ranges.tobytes() + repr((o.odometry, o.imu, o.scan.stamp)).encode() for o in seen)


def test_same_seed_same_bytes(rough: World, husky: Robot) -> None:
    first, second, other = (Simulation(rough, SimulationConfig(robot=husky), seed=s) for s in (7, 7, 8))
    a, b, c = (fingerprint(drive(s)) for s in (first, second, other))
    assert a == b
    assert a != c
    assert first.pose() == second.pose()
    # A second run of the same object is the same run, too.
    assert fingerprint(drive(first)) == a


def test_the_config_s_start_is_where_a_reset_sets_the_robot_down(plane: World, husky: Robot) -> None:
    sim = started(plane, robot=husky, start=Pose2(1.0, -2.0, 0.5))
    assert sim.pose().to_pose2().distance(Pose2(1.0, -2.0)) < 0.02
    sim.reset(Pose2(-1.0, 0.0))
    assert sim.pose().to_pose2().distance(Pose2(-1.0, 0.0)) < 0.02


@pytest.mark.parametrize("name", ["turtlebot2", "turtlebot3_burger", "jackal"])
def test_the_reference_physics_goes_the_same_way_in_steps_of_its_own(plane: World, name: str) -> None:
    sim = Simulation(plane, SimulationConfig(robot=make_robot(name)))
    drive(sim)
    before, own = sim.body.state().tobytes(), sim.replay()
    reference = sim.replay(reference=True)
    np.testing.assert_allclose(reference.T_world_base.position, own.T_world_base.position, atol=0.03)
    # The simulation goes on as if nothing had been replayed.
    assert sim.body.state().tobytes() == before
    assert sim.replay().T_world_base == own.T_world_base


def test_replay_ends_where_the_run_ended(rough: World, husky: Robot) -> None:
    sim = Simulation(rough, SimulationConfig(robot=husky))
    drive(sim)
    before = sim.pose()
    replay = sim.replay()
    assert replay.T_world_base == before
    assert sim.pose() == before
    assert replay.simulated == pytest.approx(2.4)
    assert sim.replay(seconds=1.0).simulated == pytest.approx(1.0)
    assert replay.rtf > 1
    assert sim.controls.shape == (60 * len(sim.body.substeps), 2)


def test_a_tick_is_one_lidar_period(plane: World, husky: Robot) -> None:
    for preset in LIDARS.values():
        sim = started(plane, robot=husky, lidar=preset.name)
        stamps = [sim.advance(Twist()).scan.stamp for _ in range(3)]
        np.testing.assert_allclose(stamps, np.arange(1, 4) / preset.rate, atol=1e-9)
        assert sim.body.data.time == pytest.approx(3 / preset.rate, abs=1e-6)
        assert sim.body.timestep <= 0.005
        assert sum(sim.body.substeps) * sim.body.timestep == pytest.approx(1 / preset.rate)


def test_odometry_without_noise_is_the_path_driven(make_world: Callable[..., World], husky: Robot) -> None:
    world = make_world(lambda x, y: 0.2 * np.sin(x) * np.cos(y))
    sim = started(world, Pose2(1.0, -1.0, 0.5), robot=husky, noise=SILENT)
    T_world_odom = sim.pose().to_pose2()
    for k in range(500):
        odometry = sim.advance(Twist(0.6, 0.5 * math.sin(k / 40))).odometry
    T = sim.pose().to_pose2()
    guess = T_world_odom @ odometry
    assert guess.distance(T) < 0.03 * 12
    assert abs(math.remainder(guess.yaw - T.yaw, math.tau)) < math.radians(2)
    assert T_world_odom.distance(T) > 2


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (Pose2(50.0, 0.0), "border of the world"),
        (Pose2(9.8, 0.0), "border of the world"),
        (Pose2(4.0, 0.0), "slopes by 45 deg, legal: up to 25"),
        (Pose2(-4.0, 0.0), "obstacle stands"),
    ],
)
def test_bad_start_poses(start: Pose2, words: str, make_world: Callable[..., World], husky: Robot) -> None:
    world = make_world(lambda x, y: np.maximum(0, x - 2) + 1.0 * (np.hypot(x + 4, y) < 0.25))
    sim = Simulation(world, SimulationConfig(robot=husky))
    with pytest.raises(SimulationError, match=words):
        sim.reset(start)
    with pytest.raises(SimulationError, match="must be reset"):
        sim.advance(Twist())


def test_nothing_driven_is_not_replayed(plane: World, husky: Robot) -> None:
    sim = started(plane, robot=husky)
    with pytest.raises(SimulationError, match="nothing was driven"):
        sim.replay()


def test_tipped_and_off_the_world_are_noticed(plane: World, husky: Robot) -> None:
    sim = started(plane, robot=husky)
    assert not sim.find_tipped()[0]
    assert not sim.off_world()[0]
    sim.body.data.qpos[3:7] = (math.cos(1.5), math.sin(1.5), 0, 0)
    sim.advance(Twist())
    assert sim.find_tipped()[0]
    sim.reset(Pose2(9.3, 0.0, 0.0))
    for _ in range(40):
        sim.advance(Twist(1.0))
    assert sim.off_world()[0]


def test_arguments_of_the_wrong_type(husky: Robot) -> None:
    with pytest.raises(ConfigError, match="world must be of type World, got 'simple'"):
        Simulation("simple", SimulationConfig(robot=husky))  # type: ignore[arg-type]
    for options, words in (
        ({"robot": "husky"}, "robot must be of type Robot, got 'husky'"),
        ({"noise": "much"}, "noise must be of type SensorNoise, got 'much'"),
        ({"lidar": 5}, "unknown lidar 5; legal"),
        ({"contact_geometry": "mud"}, "'mud'; legal"),
        ({"props": ["box"]}, "props must be Prop or StaticRobot, got 'box'"),
    ):
        with pytest.raises(ConfigError, match=words):
            SimulationConfig(**({"robot": husky} | options))  # type: ignore[arg-type]


def test_a_robot_too_large_for_the_world(husky: Robot, make_world: Callable[..., World]) -> None:
    with pytest.raises(ConfigError, match=r"husky is 1\.16 m wide: too large for 'synthetic' of 1 x 1 m"):
        Simulation(make_world(lambda x, y: 0 * x, nodes=11), SimulationConfig(robot=husky))
