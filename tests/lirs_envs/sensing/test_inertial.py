"""Inertial readings near 200 Hz: exact means of the motion, their rate, noise and bias."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.imu import InertialNoise, InertialUnit
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct import Pose3, World
from lirs_wct.arrays import FloatArray

EXACT = InertialNoise(rate_density=0, rate_bias=0, acceleration_density=0, acceleration_bias=0)
G = 9.81


@pytest.fixture(scope="module")
def hills(make_world: Callable[..., World]) -> World:
    return make_world(lambda x, y: 0.1 * np.sin(x / 2) * np.cos(y / 2))


def simulation(world: World, robot: str, noise: InertialNoise | None, **options: Any) -> Simulation:
    config = SimulationConfig(robot=make_robot(robot), inertial=noise, **options)
    return Simulation(world, config, seed=3)


def drive(simulation: Simulation, seconds: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Drive a curve; return stamps (n,), rates (n, 3) and specific force (n, 3)."""
    period = simulation.period
    commands = [Twist(0.5, 0.4 * math.sin(0.5 * k * period)) for k in range(round(seconds / period))]
    observations = [simulation.reset(), *map(simulation.advance, commands)]
    readings = [observation.inertial for observation in observations if observation.inertial is not None]
    return (
        np.concatenate([each.stamps for each in readings]),
        np.concatenate([each.angular_velocity for each in readings]),
        np.concatenate([each.linear_acceleration for each in readings]),
    )


def integrate(start: Pose3, rates: FloatArray, force: FloatArray, dt: float) -> tuple[FloatArray, Rotation]:
    """Return position and orientation by strapdown integration from rest, with the force at mid-interval."""
    position, velocity = np.array(start.position), np.zeros(3)
    turn = Rotation.from_matrix(start.rotation)
    for omega, f in zip(rates, force, strict=True):
        middle = turn * Rotation.from_rotvec(omega * dt / 2)
        velocity = velocity + (middle.apply(f) - (0, 0, G)) * dt
        position = position + velocity * dt
        turn = turn * Rotation.from_rotvec(omega * dt)
    return position, turn


@pytest.mark.parametrize("robot", ["husky", "jackal", "turtlebot3_burger"])
def test_readings_without_noise_integrate_to_the_driven_pose(robot: str, hills: World) -> None:
    driven = simulation(hills, robot, EXACT)
    driven.reset()
    start = driven.pose()
    stamps, rates, force = drive(driven, 5.0)
    assert len(stamps) == round(5 * len(stamps) / stamps[-1])
    position, turn = integrate(start, rates, force, float(stamps[0]))
    end = driven.pose()
    assert math.hypot(end.x - start.x, end.y - start.y) > 0.5
    assert np.linalg.norm(position - end.position) < 0.02
    assert math.degrees((turn.inv() * Rotation.from_matrix(end.rotation)).magnitude()) < 0.1


@pytest.mark.parametrize(("robot", "rate"), [("husky", 200.0), ("jackal", 250.0)])
def test_a_reading_covers_a_whole_number_of_steps_near_200_hz(robot: str, rate: float, hills: World) -> None:
    stamps, *_ = drive(simulation(hills, robot, EXACT, lidar="vlp16"), 2.0)
    np.testing.assert_allclose(stamps, np.arange(1, len(stamps) + 1) / rate, rtol=0, atol=1e-12)
    assert stamps[-1] == pytest.approx(2.0)


def test_the_allan_deviation_of_a_second_is_the_configured_density() -> None:
    noise = replace(EXACT, rate_density=0.01, acceleration_density=0.1)
    unit = InertialUnit(noise, 0.005, G)
    still = np.zeros((400 * 200, 10))
    still[:, 0] = 1
    unit.begin(still[0], np.random.default_rng(1))
    readings = unit.read(still)
    for values, density in ((readings.angular_velocity, 0.01), (readings.linear_acceleration, 0.1)):
        seconds = values.reshape(-1, round(unit.rate), 3).mean(axis=1)
        allan = np.sqrt(0.5 * np.mean(np.diff(seconds, axis=0) ** 2))
        assert allan == pytest.approx(density, rel=0.1)
    assert readings.rate_sigma == pytest.approx(np.std(readings.angular_velocity), rel=0.02)


def test_biases_are_constant_in_a_drive_and_differ_between_seeds() -> None:
    unit = InertialUnit(replace(EXACT, rate_bias=0.1), 0.005, G)
    still = np.tile(np.eye(1, 10), (100, 1))
    means = []
    for seed in range(200):
        unit.begin(still[0], np.random.default_rng(seed))
        readings = unit.read(still).angular_velocity
        assert np.ptp(readings, axis=0).max() < 1e-15
        means.append(readings[0])
    assert np.std(means) == pytest.approx(0.1, rel=0.1)
