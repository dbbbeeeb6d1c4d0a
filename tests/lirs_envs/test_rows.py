"""Many robots at once: each does bit for bit what a simulation of its own does."""

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lirs_envs.generators.terrain import HEIGHT_RANGE, generate
from lirs_envs.lidar.ray_casting import Rays
from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.imu import InertialNoise
from lirs_envs.sensing.sensors import Observation, SensorFaults, SensorNoise
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import Prop, SimulationConfig
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.world import World

START = Pose2(0.5, -0.5, 0.3)


def config_of(robot: str, method: str, rolling: bool) -> SimulationConfig:
    odometry = OdometryConfig(method="ekf" if method == "ekf" else "gyro")
    noise = SensorNoise(odometry=odometry, lidar="datasheet", rolling_scan=rolling)
    return SimulationConfig(robot=make_robot(robot), noise=noise)


def same(one: Observation, two: Observation) -> bool:
    ranges = np.array_equal(one.scan.ranges, two.scan.ranges, equal_nan=True)
    first, second = (
        (o.odometry, o.imu, o.scan.stamp, o.odometry_track, getattr(o.inertial, "linear_acceleration", None))
        for o in (one, two)
    )
    return ranges and repr(first) == repr(second)


def positions(many: Simulation) -> bytes:
    return b"".join(many.states[i].qpos.tobytes() for i in range(many.count))


def commands(robot: str, steps: int, count: int, seed: int = 1) -> np.ndarray:
    figures = make_robot(robot)
    scale = (min(figures.max_speed, 2.0), min(figures.max_turn_rate, 2.0), 0.0)
    return np.random.default_rng(seed).uniform(-1, 1, (steps, count, 3)) * scale


def drive_alike(world: World, config: SimulationConfig, *, copied: bool, steps: int = 30) -> Simulation:
    """Drive one of three robots as one alone, perhaps copied on the way, and check that they do the same."""
    alone = Simulation(world, config, seed=7)
    many = Simulation(world, config, count=3, period=alone.period, threads=2)
    for i in range(3):
        many.place(i, START, seed=7 if i == 1 else i)
    assert same(alone.reset(START), many.reading(1))
    for k, row in enumerate(commands(config.robot.name, steps, 3)):
        if copied and k == steps // 3:
            many = copy.deepcopy(many)
        many.drive(np.arange(3), row)
        assert same(alone.advance(Twist(*row[1].tolist())), many.reading(1))
    assert alone.pose() == many.pose(1)
    return many


@pytest.mark.parametrize(
    ("robot", "method", "rolling"),
    [
        ("husky", "gyro", False),
        ("jackal", "ekf", True),
        ("turtlebot2", "gyro", False),
        ("quadrotor", "gyro", True),
    ],
)
@pytest.mark.parametrize("place", ["rough", "walled"])
def test_each_is_a_simulation_of_its_own(
    robot: str, method: str, rolling: bool, place: str, rough: World, walled: World
) -> None:
    if (robot, place) == ("turtlebot2", "rough"):
        pytest.skip("too steep for it")
    world, config = (rough if place == "rough" else walled), config_of(robot, method, rolling)
    drive_alike(world, config, copied=False)


@pytest.mark.parametrize("robot", ["husky", "jackal", "quadrotor"])
def test_faults_and_inertial_readings_are_in_all_rows(robot: str, rough: World) -> None:
    faults = SensorFaults(lag=0.1, field_of_view=120.0, dust=0.1, slip=0.2 if robot == "jackal" else 0.0)
    config = config_of(robot, "gyro", rolling=False)
    noise = replace(config.noise, faults=faults)
    config = replace(config, noise=noise, inertial=InertialNoise())
    many = drive_alike(rough, config, copied=True, steps=12)
    reading = many.reading(1)
    assert reading.inertial is not None
    assert np.isnan(reading.scan.ranges).mean() > 0.5
    assert bool(reading.odometry_track) is (robot == "husky")
    assert np.array_equal(many.odometry[1], reading.odometry.as_array())


@pytest.mark.parametrize("place", ["rough", "walled"])
def test_walkers_are_those_of_a_simulation_of_its_own(place: str, rough: World, walled: World) -> None:
    world = rough if place == "rough" else walled
    config = replace(config_of("husky", "gyro", False), actors=12)
    many = drive_alike(world, config, copied=True)
    assert not same(many.reading(0), many.reading(1))


@pytest.mark.parametrize("rays", ["builtin", "mujoco"])
def test_props_are_met_as_in_a_simulation_of_its_own(rays: Rays, make_world: Callable[..., World]) -> None:
    hills = make_world(lambda x, y: 0.2 * np.sin(x) * np.cos(y), nodes=81)
    ball = Prop(shape="sphere", size=(0.3,), place=Pose2(1.6, 0.0), mass=5.0)
    box = Prop(shape="box", size=(0.2, 0.2, 0.5), place=Pose2(-1.5, 0.0, 0.4))
    config = replace(config_of("husky", "gyro", False), props=(ball, box), rays=rays)
    drive_alike(hills, config, copied=True, steps=9)


def test_threads_and_neighbors_change_nothing(rough: World) -> None:
    """Nine robots as one group, and as four that five threads share, in steps of all or of some."""
    config, told = config_of("husky", "gyro", False), commands("husky", 12, 9)
    results = []
    for threads in (1, 5):
        many = Simulation(rough, config, count=9, period=0.1, threads=threads)
        for i in range(9) if threads == 1 else reversed(range(9)):
            many.place(i, START, seed=i)
        for k, row in enumerate(told):
            if threads == 1 or k % 2:
                many.drive(np.arange(9), row)
            else:
                many.drive(np.array((0, 2)), row)
                many.drive(np.array((1, 3, 4, 5, 6, 7, 8)), row)
            if k == 6:
                many.place(6, START, seed=99)
        results.append((many.ranges.tobytes(), many.odometry.tobytes(), positions(many)))
        assert len(many.groups) == (1 if threads == 1 else 4)
        many.close()
    assert results[0] == results[1]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda b: pickle.loads(pickle.dumps(b))])
@pytest.mark.parametrize("robot", ["husky", "quadrotor"])
@pytest.mark.parametrize("place", ["rough", "walled"])
def test_a_copy_goes_on_bit_for_bit(copied, robot: str, place: str, rough: World, walled: World) -> None:  # type: ignore[no-untyped-def]
    config = config_of(robot, "gyro", False)
    many = Simulation(rough if place == "rough" else walled, config, count=2, period=0.1, threads=2)
    for i in range(2):
        many.place(i, START, seed=i)
    ids = np.arange(2)
    for row in commands(robot, 5, 2):
        many.drive(ids, row)
    again = copied(many)
    for batch in (again, many):
        for row in commands(robot, 5, 2, seed=3):
            batch.drive(ids, row)
    assert positions(again) == positions(many)
    assert all(same(again.reading(i), many.reading(i)) for i in range(2))


def test_scans_come_at_the_lidar_s_rate(plane: World) -> None:
    many = Simulation(plane, config_of("turtlebot3_burger", "gyro", False), count=1, period=0.02)
    many.place(0, START, seed=0)
    stamps = []
    for _ in range(50):
        many.drive(np.array((0,)), np.array(((0.2, 0.0, 0.0),)))
        stamps.append(many.reading(0).scan.stamp)
    assert sorted(set(stamps)) == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


def test_contact_is_felt(walled: World, plane: World) -> None:
    """Driving into a wall touches it; driving on level ground touches nothing."""
    for world, touches in ((walled, True), (plane, False)):
        many = Simulation(world, config_of("husky", "gyro", False), count=1, period=0.1)
        many.place(0, Pose2(1.5, 0.0, 0.4), seed=0)
        touched = False
        for _ in range(40):
            many.drive(np.array((0,)), np.array(((1.0, 0.0, 0.0),)))
            touched |= bool(many.touched[0])
        assert touched is touches


def test_a_robot_that_diverges_stops_alone(plane: World) -> None:
    many = Simulation(plane, config_of("husky", "gyro", False), count=2, period=0.1)
    for i in range(2):
        many.place(i, START, seed=i)
    before = many.ranges[0].tobytes()
    many.states[0].qvel[0] = np.nan
    many.drive(np.arange(2), np.zeros((2, 3)))
    assert "diverged" in many.errors[0]
    assert not many.errors[1]
    assert many.ranges[0].tobytes() == before
    assert np.isfinite(many.odometry).all()
    many.place(0, START, seed=0)
    many.drive(np.arange(2), np.zeros((2, 3)))
    assert many.errors == ["", ""]


def test_another_terrain_for_one_robot(husky: object) -> None:
    courses = [generate("waves", 0.5, np.random.default_rng(s)) for s in range(2)]
    config = replace(config_of("husky", "gyro", False), height_range=HEIGHT_RANGE)
    many = Simulation(courses[0].world(), config, count=2, period=0.1)
    alone = Simulation(courses[1].world(), config, count=1, period=0.1)
    many.replace_terrain(courses[1].world(), 1)
    many.place(0, courses[0].start, seed=0)
    many.place(1, courses[1].start, seed=1)
    alone.place(0, courses[1].start, seed=1)
    for row in commands("husky", 10, 2):
        many.drive(np.arange(2), row)
        alone.drive(np.arange(1), row[1:])
    assert same(many.reading(1), alone.reading(0))
    assert not same(many.reading(0), alone.reading(0))


def test_what_cannot_be(plane: World) -> None:
    many = Simulation(plane, config_of("husky", "gyro", False), count=1, period=0.1)
    with pytest.raises(SimulationError, match=r"it needs 0\.58 m to the border"):
        many.place(0, Pose2(9.9, 0.0), seed=0)
    with pytest.raises(ConfigError, match="cannot be replaced: it has no height range"):
        many.replace_terrain(plane, 0)
