from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_extensions.search.twin.fit import fit_odometry, odometry_deviations
from lirs_extensions.search.twin.replay import (
    Replay,
    ReplayedMapper,
    TwinPath,
    replay_table,
    simulate_odometry,
)
from lirs_wct.geometry import LaserScan, Pose2, Trajectory

ERRORS = st.floats(0.001, 100.0)


def turning_path(length: float) -> Trajectory:
    """Return poses every 5 cm of a path that turns left and right, ten a second."""
    s = np.arange(0, length, 0.05)
    yaw = np.sin(s / 6)
    x, y = np.cumsum(0.05 * np.cos(yaw)), np.cumsum(0.05 * np.sin(yaw))
    return Trajectory.from_poses(0.1 * np.arange(len(s)), map(Pose2, x.tolist(), y.tolist(), yaw.tolist()))


def test_simulated_odometry_has_the_errors_of_its_noise() -> None:
    noise = SensorNoise(
        odometry=OdometryConfig(scale_sigma=0.04, scale_bias=0.03),
        imu=ImuConfig(rate_sigma=0.02, rate_bias=0.0),
    )
    path = turning_path(600.0)
    odometry = Trajectory.from_poses(path.stamps, simulate_odometry(path, noise, seed=3))
    truth, measured = path.planar_at(path.stamps), odometry.planar_at(path.stamps)
    fitted = fit_odometry(measured, truth, path.stamps, truth, 5.0, seed=5)
    assert fitted is not None
    assert fitted.scale_sigma[0] == pytest.approx(0.04, rel=0.15)
    assert fitted.scale == pytest.approx(0.03, abs=0.006)
    assert fitted.rate_sigma[0] == pytest.approx(0.02, rel=0.1)


def test_without_noise_the_simulated_log_is_exact() -> None:
    rng = np.random.default_rng(1)
    path = turning_path(2.0)
    scans = tuple(LaserScan(np.ones(5, np.float32), -1.0, 0.5, 0.0, 30.0, stamp) for stamp in path.stamps)
    exact = rng.uniform(1, 20, (len(scans), 5))
    objects = np.full(exact.shape, np.nan)
    objects[3, 2] = 0.5
    exactly = SensorNoise(
        lidar=LidarNoise(), odometry=OdometryConfig(scale_sigma=0), imu=ImuConfig(rate_sigma=0, rate_bias=0)
    )
    residual = np.full(exact.shape, np.nan)
    twin = TwinPath(scans, path, exact, objects, residual, path.planar_at(path.stamps))
    log = twin.simulate_log(exactly, seed=1, resampled=True)
    exact[3, 2] = 0.5
    np.testing.assert_allclose([scan.ranges for scan, _ in log], exact, rtol=1e-6)
    T_odom_map = path.pose2(0).inverse()
    for k, (scan, odometry) in enumerate(log):
        assert scan.stamp == path.stamps[k]
        np.testing.assert_allclose(odometry.as_array(), (T_odom_map @ path.pose2(k)).as_array(), atol=1e-9)


def test_resampled_noise_is_that_of_blocks_of_the_log() -> None:
    path, rng = turning_path(30.0), np.random.default_rng(2)
    scans = tuple(LaserScan(np.ones(9, np.float32), -1.0, 0.2, 0.0, 30.0, stamp) for stamp in path.stamps)
    exact = rng.uniform(1, 20, (len(scans), 9))
    residual = 0.01 * np.arange(exact.size).reshape(exact.shape) / exact.size
    objects = np.full(exact.shape, np.nan)
    noise = SensorNoise(lidar=LidarNoise(sigma=0.05))
    twin = TwinPath(scans, path, exact, objects, residual, None)
    drawn = np.array([scan.ranges for scan, _ in twin.simulate_log(noise, seed=4, resampled=True)]) - exact
    source = np.round(drawn[:, 0] / residual[1, 0]).astype(int)
    np.testing.assert_allclose(drawn, residual[source], atol=2e-6)
    assert (np.diff(source) == 1).mean() > 0.9, "scans of a block stay together"
    assert len(set(source.tolist())) < len(scans), "with replacement"
    plain = np.array([scan.ranges for scan, _ in twin.simulate_log(noise, seed=4)]) - exact
    assert plain.std() == pytest.approx(0.05, rel=0.1)


def test_odometry_errors_of_log_and_simulation_are_compared() -> None:
    noise = SensorNoise(odometry=OdometryConfig(scale_sigma=0.04), imu=ImuConfig(rate_sigma=0.05))
    path = turning_path(400.0)
    poses = path.planar_at(path.stamps)
    found = [
        odometry_deviations(np.array([p.as_array() for p in simulate_odometry(path, noise, seed)]), poses)
        for seed in (1, 2)
    ]
    assert None not in found
    np.testing.assert_allclose(*found, rtol=0.25)
    exact = odometry_deviations(poses, poses)
    assert exact == pytest.approx((0.0, 0.0), abs=1e-9)
    assert odometry_deviations(poses[:200], poses[:200]) is None


@given(st.lists(ERRORS, min_size=3, max_size=40), ERRORS)
def test_an_error_on_the_log_is_inside_the_interval_or_not(drawn: list[float], real: float) -> None:
    mapper = ReplayedMapper("hector", real, tuple(drawn))
    spread, text = mapper.spread, mapper.sentence("ATE")
    assert spread is not None
    assert mapper.inside == (spread.low <= real <= spread.high)
    assert f"{spread.low:.3f} and {spread.high:.3f} m in {spread.count} draws" in text
    assert text.endswith("m: inside." if mapper.inside else "m: outside.")
    assert sum(low < spread.low for low in drawn) == sum(high > spread.high for high in drawn) or (
        len(set(drawn)) < len(drawn)
    )
    unknown = replace(mapper, real=None)
    assert unknown.inside is None
    assert unknown.sentence("ATE").endswith("draws.")


def test_a_mapper_without_errors_says_why() -> None:
    text = Replay("ATE", (ReplayedMapper("gmapping", reason="needs odometry"),)).sentences[0]
    assert text == "gmapping has no error in the simulation: needs odometry."
    assert replay_table(Replay("ATE", (ReplayedMapper("gmapping"),))).rows[0][1:5] == ("-",) * 4
