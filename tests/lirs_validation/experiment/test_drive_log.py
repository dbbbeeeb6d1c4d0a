"""Log of a drive: its size in memory, and the observations that it holds."""

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation import Simulation
from lirs_validation.config import RunConfig
from lirs_validation.driving.choice import make_driver
from lirs_validation.experiment.drive import DriveLog, drive
from lirs_validation.experiment.mapper_under_test import LocalMapper
from lirs_validation.experiment.scenario import build_scenario
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.mapper import MapperStats


class DeadReckoning:
    """A mapper that keeps nothing."""

    lost = False
    stats = MapperStats()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        return odometry or Pose2()

    def trajectory(self) -> Trajectory:
        return Trajectory.from_poses([], [])


def drive_in(
    world: str, seconds: float, lidar: str | None = None
) -> tuple[Simulation, DriveLog, Iterator[float]]:
    config = RunConfig(source=world, seconds=seconds, seed=2, lidar=lidar)
    scenario, robot = build_scenario(config), make_robot("husky")
    driver = make_driver(scenario.world, robot, config, lambda: None)  # type: ignore[arg-type, return-value]
    mapper = LocalMapper(DeadReckoning(), "dead reckoning")  # type: ignore[arg-type]
    simulation, log = scenario.simulation(robot), DriveLog()
    return simulation, log, drive(simulation, driver, mapper, log, seconds)


def go_on(ticks: Iterator[float], until: float) -> int:
    """Drive to a time; return the bytes that Python then holds of what was allocated since tracing began."""
    for time in ticks:
        if time >= until:
            break
    return tracemalloc.get_traced_memory()[0]


@pytest.mark.parametrize("lidar", [None, "vlp16"])
def test_an_hour_of_driving_takes_less_than_a_gigabyte(lidar: str | None, room: str) -> None:
    *_, ticks = drive_in(room, 40, lidar)
    go_on(ticks, 1)
    tracemalloc.start()
    try:
        begun, ended = go_on(ticks, 2), go_on(ticks, 4)
    finally:
        tracemalloc.stop()
    assert (ended - begun) / 2 < 1e9 / 3600


def test_the_log_holds_the_observations(room: str) -> None:
    simulation, log, ticks = drive_in(room, 2, "vlp16")
    seen = []
    advance = simulation.advance
    simulation.advance = lambda command: seen.append(advance(command)) or seen[-1]  # type: ignore
    assert len(list(ticks)) == 21
    assert len(seen) == len(log.observations) - 1 == 20
    for kept, given in zip(log.observations[1:], seen, strict=True):
        np.testing.assert_array_equal(kept.scan.ranges, given.scan.ranges)
        beam = given.scan.ranges[:1]  # comparing arrays of more is ambiguous
        assert replace(kept.scan, ranges=beam) == replace(given.scan, ranges=beam)
        assert (kept.odometry, kept.imu, kept.cloud) == (given.odometry, given.imu, None)
