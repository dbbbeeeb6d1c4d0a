"""Odometry and IMU are as wrong as they claim; the filter knows how wrong it is."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats

from lirs_envs.robots.robot import Robot, Twist, make_robot
from lirs_envs.sensing.imu import ImuConfig, ImuSensors
from lirs_envs.sensing.odometry import DistanceNoise, EkfConfig, EkfOdometry, FlowOdometry
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_envs.simulation import ROW
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.world import World
from tests.kit import started

EKF = OdometryConfig(method="ekf")
EXACT_WHEELS = EkfConfig(slip_forward=0, slip_lateral=0, slip_turning=0, tilt=0)
DT, TICK = 0.008, 5


def imu_of(config: ImuConfig, seed: int | tuple[int, int]) -> ImuSensors:
    imu = ImuSensors(config, 1)
    imu.begin(
        0, np.array(((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),)), np.zeros((1, 6)), np.random.default_rng(seed)
    )
    return imu


def read_roll(imu: ImuSensors) -> float:
    imu.read(ROW, np.array(((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),)), np.array(((0.0, 0.0, 9.81),)), 0.2)
    return float(imu.attitude[0, 0])


def read_rates(imu: ImuSensors, true: tuple[float, float, float]) -> tuple[float, float, float]:
    imu.draw(ROW, 1)
    imu.read_rates(ROW, np.array(((0.0, 0.0, 0.0, *true),)))
    x, y, z = imu.rates[0].tolist()
    return x, y, z


def test_the_scale_error_wanders_over_its_length() -> None:
    config = OdometryConfig()
    series = []
    for seed in range(400):
        wheels = DistanceNoise(config, np.random.default_rng(seed))
        series.append([wheels.measure(0.05) / 0.05 - 1 for _ in range(200)])
    errors = np.array(series)
    assert errors.std() == pytest.approx(config.scale_sigma, rel=0.05)
    # Chi-square of one value each run: they are independent.
    z = errors[:, 100] / config.scale_sigma
    assert 1e-4 < stats.chi2.cdf(z @ z, 400) < 1 - 1e-4
    for meters in (2.5, 5.0):
        lag = round(meters / 0.05)
        kept = np.mean(errors[:, :-lag] * errors[:, lag:]) / errors.var()
        assert kept == pytest.approx(math.exp(-meters / config.scale_length), abs=0.12)


def test_the_attitude_s_bias_wanders_over_its_time() -> None:
    config = ImuConfig(attitude_sigma=0.0)
    rolls = []
    for seed in range(400):
        imu = imu_of(config, seed)
        rolls.append([read_roll(imu) for _ in range(100)])
    errors = np.array(rolls)
    assert errors.std() == pytest.approx(config.attitude_bias, rel=0.1)
    kept = np.mean(errors[:, :-50] * errors[:, 50:]) / errors.var()
    assert kept == pytest.approx(math.exp(-1), abs=0.12)


def test_gyro_and_accelerometer_noise_is_white_and_gaussian() -> None:
    config = ImuConfig(rate_bias=0.0, acceleration_bias=0.0)
    imu = imu_of(config, 3)
    z = np.array([read_rates(imu, (0.1, 0.2, 0.3)) for _ in range(16_667)]) - (0.1, 0.2, 0.3)
    z = z.ravel() / config.rate_sigma
    assert 1e-4 < stats.chi2.cdf(z @ z, len(z)) < 1 - 1e-4
    assert stats.kstest(z, "norm").pvalue > 1e-4
    assert abs(np.mean(z[3:] * z[:-3])) < 4 / math.sqrt(len(z))


def blind_drive(odometry: EkfOdometry, imu: ImuSensors, seed: int, ticks: int, stops: bool) -> Pose2:
    """Drive on a plane by the book; return the true pose."""
    rng, truth = np.random.default_rng(1000 + seed), Pose2()
    radius, v, omega = odometry.robot.wheel_radius, 0.0, 0.0
    for k in range(ticks):
        if k % 50 == 0:
            v, omega = rng.uniform(0.2, 1.0), rng.uniform(-0.6, 0.6)
            if stops and k % 200 == 0:
                v = omega = 0.0
        for _ in range(TICK):
            middle = truth.yaw + omega * DT / 2
            truth = Pose2(
                truth.x + v * DT * math.cos(middle),
                truth.y + v * DT * math.sin(middle),
                truth.yaw + omega * DT,
            )
            turn = omega * DT * odometry.robot.track * odometry.robot.skid_factor / radius
            odometry.update(v * DT / radius, read_rates(imu, (0.0, 0.0, omega)), 0.0, 0.0, DT, turn)
        odometry.read()
    return truth


def error_of(p: Pose2, truth: Pose2) -> np.ndarray:
    return np.array((p.x - truth.x, p.y - truth.y, math.remainder(p.yaw - truth.yaw, math.tau)))


@pytest.mark.parametrize(
    ("name", "stops"),
    [
        ("husky", True),
        *(pytest.param(*row, marks=pytest.mark.slow) for row in (("husky", False), ("turtlebot2", True))),
    ],
)
def test_the_filter_is_consistent(name: str, stops: bool) -> None:
    """Normalized estimation error squared (Bar-Shalom, Li and Kirubarajan 2001, sec. 5.4.2)."""
    robot, config, nees, n = make_robot(name), ImuConfig(), [], 40
    for seed in range(n):
        rng = np.random.default_rng(seed)
        imu = imu_of(config, (seed, 1))
        odometry = EkfOdometry(robot, EKF, rng, config, EXACT_WHEELS)
        truth = blind_drive(odometry, imu, seed, 200, stops)
        e = error_of(odometry.read(), truth)
        nees.append(e @ np.linalg.solve(odometry.covariance[:3, :3], e))
    low, high = stats.chi2.ppf((1e-4, 1 - 1e-4), 3 * n) / n
    # Where the wheels of one axle tell the turn exactly, the filter is told that they might not.
    assert (low if name == "husky" else 1.0) < np.mean(nees) < high


def test_standing_teaches_the_bias(husky: Robot) -> None:
    config = ImuConfig(rate_bias=math.radians(0.5))
    imu = imu_of(config, 5)
    odometry = EkfOdometry(husky, EKF, np.random.default_rng(0), config)
    for _ in range(250):
        for _ in range(TICK):
            odometry.update(0.0, read_rates(imu, (0.0, 0.0, 0.0)), 0.0, 0.0, DT, 0.0)
        odometry.read()
    true = float(imu.rate_bias[0, 2])
    assert odometry.state[3] == pytest.approx(true, abs=4 * config.rate_sigma / math.sqrt(1250))
    assert math.sqrt(odometry.covariance[3, 3]) < 0.01 * config.rate_bias * 10


def simulated(
    world: World, robot: Robot, method: str, seed: int, stops: bool
) -> tuple[Any, np.ndarray, bytes]:
    noise = SensorNoise(odometry=OdometryConfig(method=method))  # type: ignore[arg-type]
    sim = started(world, robot=robot, noise=noise, lidar="lms111", seed=seed)
    T_world_odom, rng, seen = sim.pose().to_pose2(), np.random.default_rng(seed), []
    for k in range(400):
        if k % 50 == 0:
            moves = not (stops and k % 100 == 50)
            command = Twist(moves * rng.uniform(0.2, 0.5), moves * rng.uniform(-0.6, 0.6))
        seen.append(sim.advance(command).odometry)
    truth = T_world_odom.inverse() @ sim.pose().to_pose2()
    return sim.groups[0]._odometry, error_of(seen[-1], truth), repr(seen).encode()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["husky", "turtlebot2"])
def test_in_the_simulation_the_filter_knows_how_wrong_it_is(name: str, make_world: Callable) -> None:
    world = make_world(lambda x, y: 0.1 * np.sin(x / 2) * np.cos(y / 2))
    nees = []
    for seed in range(8):
        odometries, e, _ = simulated(world, make_robot(name), "ekf", seed, stops=True)
        odometry = odometries.of[0]
        assert isinstance(odometry, EkfOdometry)
        nees.append(float(e @ np.linalg.solve(odometry.covariance[:3, :3], e)))
    # Slip is no Gaussian: within a factor of two and a half of three degrees of freedom.
    assert 3 / 2.5 < np.mean(nees) < 3 * 2.5


@pytest.mark.slow
def test_the_filter_is_not_worse_and_better_with_stops(plane: World, husky: Robot) -> None:
    yaw = {}
    for stops in (False, True):
        for method in ("gyro", "ekf"):
            errors = [simulated(plane, husky, method, seed, stops)[1] for seed in range(5)]
            yaw[method, stops] = math.sqrt(float(np.mean(np.square(errors)[:, 2])))
    assert yaw["ekf", False] <= 1.01 * yaw["gyro", False]
    assert yaw["ekf", True] < 0.6 * yaw["gyro", True]


def test_flow_odometry_stays_where_two_readings_have_one_stamp() -> None:
    odometry = FlowOdometry(OdometryConfig(), np.random.default_rng(0))
    odometry.update(Pose3(), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, 0.0, 0.0)
    assert odometry.read() == Pose2()
    odometry.update(Pose3(), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.0, 0.0, 0.1)
    assert odometry.read() == Pose2(0.0, 0.0, 0.1)
