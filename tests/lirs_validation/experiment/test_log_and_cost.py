"""What a run costs, and how busy the system is."""

import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation import Simulation
from lirs_validation.config import RunConfig
from lirs_validation.driving.choice import make_driver
from lirs_validation.experiment.drive import DriveLog, drive
from lirs_validation.experiment.mapper_under_test import LocalMapper
from lirs_validation.experiment.scenario import build_scenario
from lirs_validation.processes import CostMeter, compile_timer, is_shared, load_average
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.mapper import MapperStats

PEAKS = """
import numpy as np
from lirs_validation.processes import CostMeter
meter = CostMeter()
before = meter.cost().peak_memory
block = np.ones(200_000_000, np.uint8)
high = meter.cost().peak_memory
del block
print(before, high, CostMeter().cost().peak_memory)
"""


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak is reset on Linux only")
def test_peak_memory_is_of_the_run_alone() -> None:
    """In a process of its own, whose memory no other test gives back meanwhile."""
    done = subprocess.run([sys.executable, "-c", PEAKS], capture_output=True, text=True, check=True)
    before, high, after = map(int, done.stdout.split())
    assert 190e6 < high - before < 400e6
    assert after < high - 150e6


def test_processor_time_is_counted_and_waiting_is_not() -> None:
    meter = CostMeter()
    time.sleep(0.2)
    waited = meter.cost().cpu_seconds
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
    assert waited < 0.15
    assert 0.2 <= meter.cost().cpu_seconds < 0.6


def test_compilation_is_timed_and_all_else_is_not() -> None:
    kernel = njit(lambda x: x + 1)
    with compile_timer() as compile_seconds:
        time.sleep(0.1)
        assert compile_seconds() == 0.0
        kernel(1)
        first = compile_seconds()
        kernel(2)
    assert first > 0.0
    assert compile_seconds() == first


def test_a_load_above_the_cores_means_a_shared_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    for load, shared in ((0.4, False), (2.0, False), (2.1, True)):
        monkeypatch.setattr("os.getloadavg", lambda load=load: (load, 9.0, 9.0), raising=False)
        assert load_average() == load
        assert is_shared(load) == shared


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
    for driven in ticks:
        if driven >= until:
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
