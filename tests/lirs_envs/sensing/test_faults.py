"""Faults of sensors: lag, field of view, dust, slip."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lirs_envs.generators.arena import ArenaConfig, arena
from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.sensors import (
    DUST_RANGES,
    FaultInjector,
    Observation,
    SensorFaults,
    SensorNoise,
    read_noise,
    write_noise,
)
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct import Pose2
from lirs_wct.errors import ConfigError, SourceError

WORLD = arena("arena", ArenaConfig())
QUIET = SensorNoise(lidar="none")


def drive(noise: SensorNoise, count: int = 25) -> list[Observation]:
    simulation = Simulation(WORLD, SimulationConfig(robot=make_robot("husky"), noise=noise), seed=3)
    return [simulation.reset(), *(simulation.advance(Twist(0.8, 0.4)) for _ in range(count))]


def test_late_scans_are_those_of_before_with_the_stamps_of_now() -> None:
    plain, late = drive(QUIET), drive(replace(QUIET, faults=SensorFaults(lag=0.12)))
    behind = 3  # 0.12 s at 25 Hz
    for k in range(behind, len(plain)):
        assert late[k].scan.stamp == plain[k].scan.stamp
        np.testing.assert_array_equal(late[k].scan.ranges, plain[k - behind].scan.ranges)
        assert late[k].odometry == plain[k].odometry
    assert not np.array_equal(late[-1].scan.ranges, plain[-1].scan.ranges)


def test_beams_outside_the_field_of_view_are_invalid() -> None:
    seen = drive(replace(QUIET, faults=SensorFaults(field_of_view=90.0)), 1)[-1].scan
    inside = np.abs(seen.angles) <= math.radians(45) + 1e-9
    assert np.isnan(seen.ranges[~inside]).all()
    np.testing.assert_array_equal(seen.ranges[inside], drive(QUIET, 1)[-1].scan.ranges[inside])


def test_dust_returns_near_beams_in_its_share() -> None:
    plain, dusty = drive(QUIET), drive(replace(QUIET, faults=SensorFaults(dust=0.1)))
    changed = np.array([~np.isclose(a.scan.ranges, b.scan.ranges) for a, b in zip(plain, dusty, strict=True)])
    assert changed.mean() == pytest.approx(0.1, abs=0.01)
    near = np.concatenate([o.scan.ranges[c] for o, c in zip(dusty, changed, strict=True)])
    assert near.min() >= DUST_RANGES[0]
    assert near.max() <= DUST_RANGES[1]


@pytest.mark.parametrize(("pitch", "roll", "expected"), [(-0.2, 0.0, "longer"), (0.2, 0.0, "shorter")])
def test_wheels_slip_with_the_slope(pitch: float, roll: float, expected: str) -> None:
    injector = FaultInjector(SensorFaults(slip=0.3), make_lidar_preset("lms111"), 0)
    measured = injector.odometry(Pose2(1.0, 0.0, 0.0), roll, pitch)
    factor = 1 - 0.3 * math.sin(pitch)
    assert measured.x == pytest.approx(factor)
    assert (measured.x > 1) == (expected == "longer")
    again = injector.odometry(Pose2(2.0, 0.0, 0.0), 0.0, 0.0)
    assert again.x == pytest.approx(factor + 1.0)


def test_wheels_do_not_measure_the_slide_across_a_slope() -> None:
    injector = FaultInjector(SensorFaults(slip=0.2), make_lidar_preset("lms111"), 0)
    measured = injector.odometry(Pose2(1.0, 0.0, 0.0), 0.3, 0.0)
    # The right side is down: the robot slides to its right, -y, and the odometry is left of it.
    assert measured.y == pytest.approx(0.2 * math.sin(0.3))


def test_faults_are_a_section_of_a_noise_file(tmp_path: Path) -> None:
    noise = SensorNoise(lidar=LidarNoise(), faults=SensorFaults(lag=0.06, dust=0.02))
    write_noise(tmp_path / "a.yaml", noise, "a line")
    assert read_noise(tmp_path / "a.yaml") == noise
    write_noise(tmp_path / "b.yaml", replace(noise, faults=SensorFaults()), "a line")
    assert "faults" not in (tmp_path / "b.yaml").read_text()


def test_illegal_faults_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "noise.yaml"
    path.write_text("faults: {lag: 3}\n")
    with pytest.raises(SourceError, match=r"noise.yaml: lag of the sensor faults must be within \[0, 1\] s"):
        read_noise(path)
    with pytest.raises(ConfigError, match="faults of planar lidars"):
        FaultInjector(SensorFaults(dust=0.1), make_lidar_preset("vlp16"), 0)
