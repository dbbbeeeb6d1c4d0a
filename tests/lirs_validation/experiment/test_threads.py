"""A mapper beside the drive, in a process or a thread: the bytes of one thread, and nothing that hangs."""

import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_envs.sensing.sensors import Observation
from lirs_validation import Run, RunConfig, read_record, validate
from lirs_validation.experiment import loop
from lirs_validation.experiment.drive_log import DriveLog
from lirs_validation.experiment.loop import Drive, drive
from lirs_validation.experiment.mapper_process import MapperProcess
from lirs_validation.experiment.mapper_under_test import Estimate, MapperUnderTest
from lirs_validation.experiment.run import prepare, run
from lirs_validation.record.schema import schema_error
from lirs_validation.sweep.engines import Processes
from lirs_validation.sweep.experiment import SlamExperiment
from lirs_wct.errors import ConfigError, MapperError
from lirs_wct.progress import no_progress
from tests.lirs_validation.experiment.mapper_processes import mapper_processes
from tests.lirs_validation.experiment.puppets import Puppet, SlowPuppet

TIMED = ("rtf.csv", "record.json", "overview.png", "manifest-sha256.txt")
"""Files that hold what the clock says."""
MODULE = """
import threading, time
from slam_baselines.hector.mapper import HectorMapper

class Slow(HectorMapper):
    def update(self, scan, odometry, imu):
        time.sleep(0.002)  # the simulation gets ahead
        return super().update(scan, odometry, imu)

class Lost(Slow):
    begin, end = 1.0, 99.0
    def update(self, scan, odometry, imu):
        self.stamp = scan.stamp
        return super().update(scan, odometry, imu)
    @property
    def lost(self): return self.begin <= self.stamp < self.end

class LostForAWhile(Lost):
    end = 5.9

class Failing(Slow):
    def update(self, scan, odometry, imu):
        if scan.stamp > 1.0: raise ValueError("no more")
        return super().update(scan, odometry, imu)


class Hanging(Slow):
    def update(self, scan, odometry, imu):
        while scan.stamp > 0.5: time.sleep(0.01)
        return super().update(scan, odometry, imu)
"""


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "own_slam.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_slam", raising=False)
    yield
    assert not mapper_processes()


def both(**options: Any) -> tuple[Run, Run]:
    """Return the run of one thread and that of two."""
    one, two = (validate(**options, threads=n, out=f"out{n}") for n in (1, 2))
    return one, two


def untimed(made: Run) -> dict[str, Any]:
    assert made.folder is not None
    entry = read_record(made.folder)
    assert schema_error(entry) is None
    rtf = {name: entry["rtf"][name] for name in ("simulated_seconds", "extrapolated")}
    counts = {key: value for key, value in entry["mapper"].items() if not key.startswith("ms_")}
    config = {key: value for key, value in entry["config"].items() if key != "threads"}
    kept = ("world", "status", "reason", "trajectory", "map", "collisions", "seed", "versions")
    return {key: entry[key] for key in kept} | {"rtf": rtf, "mapper": counts, "config": config}


def assert_same(one: Run, two: Run) -> None:
    assert untimed(one) == untimed(two)
    assert one.folder is not None
    assert two.folder is not None
    names = {path.name for path in one.folder.iterdir()}
    assert names == {path.name for path in two.folder.iterdir()}
    for name in sorted(names.difference(TIMED)):
        assert (one.folder / name).read_bytes() == (two.folder / name).read_bytes(), name
    assert len(one.log.commands) == len(two.log.commands)
    assert len(one.record.rtf["series"]) == len(two.record.rtf["series"])


@pytest.mark.parametrize("mapper", ["hector", "gmapping", "cartographer", "own_slam:Slow"])
def test_two_threads_give_the_same_bytes(mapper: str) -> None:
    one, two = both(source="medium", mapper=mapper, seconds=6, seed=2, actors=8, bag="sqlite3")
    assert_same(one, two)
    assert one.log.walker_beams
    assert one.record.name != two.record.name
    assert two.record.config.threads == 2
    inside = "process" if ":" in mapper else "drive"
    assert (one.record.rtf["mapper_in"], two.record.rtf["mapper_in"]) == (inside, "process")


@pytest.mark.parametrize("mapper", ["Lost", "LostForAWhile"])
def test_a_drive_that_gets_lost_ends_at_the_same_scan(mapper: str) -> None:
    one, two = both(source="simple", mapper=f"own_slam:{mapper}", seconds=8)
    assert_same(one, two)
    assert one.record.status == "lost"
    assert one.record.rtf["simulated_seconds"] == pytest.approx(6.0 if mapper == "Lost" else 8.0, abs=0.05)


def test_a_driver_that_is_done_early_ends_the_drive_at_the_same_scan(tmp_path: Path) -> None:
    start = validate("simple", seconds=1).log.start
    (tmp_path / "near.csv").write_text(f"{start.x},{start.y}\n{start.x + 1},{start.y}\n")
    one, two = both(source="simple", driver="waypoints:near.csv", mapper="own_slam:Slow", seconds=30)
    assert_same(one, two)
    assert one.record.status == "ok"
    assert 1 < one.record.rtf["simulated_seconds"] < 25


def test_a_mapper_that_raises_is_told_as_with_one_thread() -> None:
    told = []
    for threads in (1, 2):
        with pytest.raises(MapperError) as raised:
            validate("simple", mapper="own_slam:Failing", seconds=4, threads=threads, out="out")
        told.append(str(raised.value))
    assert told[0] == told[1]
    assert "1.040 s: ValueError: no more" in told[0]
    assert "in update\n    if scan.stamp > 1.0" in raised.value.__notes__[0]  # where, in the other process
    assert not Path("out").exists()


def test_a_cloud_mapper_has_its_process_too() -> None:
    (Path.cwd() / "own_clouds.py").write_text(
        "import time\n"
        "from lirs_wct.geometry.pose import Pose3\n"
        "from lirs_wct.geometry.pose import Trajectory\n"
        "from slam_baselines.mapper import MapperStats\n"
        "class Still:\n"
        "    reads_clouds, lost, stats = True, False, MapperStats()\n"
        "    def __init__(self): self.stamps, self.poses = [], []\n"
        "    def update(self, cloud, imu):\n"
        "        time.sleep(0.01)\n"
        "        self.stamps.append(cloud.stamp)\n"
        "        self.poses.append(Pose3(float(cloud.xyz.mean()) / 1000, 0.0, 0.0))\n"
        "        return self.poses[-1]\n"
        "    def trajectory(self): return Trajectory.from_poses(self.stamps, self.poses)\n"
    )
    options = {"mapper": "own_clouds:Still", "lidar": "vlp16", "seconds": 3, "actors": 8}
    one, two = both(source="medium", **options)
    assert_same(one, two)
    for a, b in zip(one.log.clouds.clouds, two.log.clouds.clouds, strict=True):
        np.testing.assert_array_equal(a.xyz, b.xyz)


def test_the_simulation_counts_no_tick_beyond_the_log() -> None:
    counted = []
    for threads in (1, 2):
        config = RunConfig(source="simple", mapper="own_slam:Lost", seconds=8, threads=threads)
        ready = prepare(config)
        with closing(ready.mapper):
            log = drive(ready.simulation, ready.driver, ready.mapper, 8.0)
        counted.append((ready.simulation.controls, ready.simulation.collisions, ready.simulation.time))
        assert len(ready.simulation.timing.physics) == len(log.walls) == len(log.commands)
    np.testing.assert_array_equal(counted[0][0], counted[1][0])
    assert counted[0][1:] == counted[1][1:]


def test_the_parts_of_the_time_add_up() -> None:
    config = RunConfig(source="simple", mapper="own_slam:Slow", seconds=4, threads=2)
    ready = prepare(config)
    with closing(ready.mapper):
        begun = time.perf_counter()
        log = drive(ready.simulation, ready.driver, ready.mapper, 4.0)
        assert 0.9 * (time.perf_counter() - begun) < sum(log.walls) < time.perf_counter() - begun
    two = validate("simple", mapper="own_slam:Slow", seconds=4, threads=2).record.rtf
    parts = two["parts"]
    assert set(parts) == {"physics", "sensors", "mapper", "waiting", "rest"}
    assert min(parts.values()) >= 0
    beside = sum(parts.values()) - parts["mapper"]
    assert beside == pytest.approx(1 / two["mean"])
    assert parts["waiting"] < parts["mapper"]  # it worked beside the simulation


def puppets(fails: str, threads: int, **options: Any) -> tuple[DriveLog, Puppet, SlowPuppet]:
    sim, mapper = Puppet(fails, 40), SlowPuppet()
    log = drive(sim, sim, under_test(mapper, threads), 4.0, **options)  # type: ignore[arg-type]
    return log, sim, mapper


class LateMapper(MapperUnderTest):
    """Mapper whose estimates come some scans later, as those of one in another process."""

    place = "process"
    follow = MapperProcess.follow  # type: ignore[assignment]
    _look_ahead, late = True, 7

    def __init__(self, mapper: Any) -> None:
        super().__init__(lambda: mapper, "late")
        self._given = list[Observation]()

    @property
    def _answered(self) -> bool:
        return len(self._given) > self.late

    def _give(self, observation: Observation) -> None:
        self._given.append(observation)

    def _answer(self) -> Estimate:
        return self.observe(self._given.pop(0))


def under_test(mapper: Any, threads: int = 2) -> MapperUnderTest:
    return LateMapper(mapper) if threads > 1 else mapper.under_test


@pytest.mark.parametrize("fails", ["tipped", "off world", "stuck", "diverged", "nothing"])
def test_a_failure_ends_both_at_the_same_tick(fails: str) -> None:
    (one, sim1, mapper1), (two, sim2, mapper2) = (puppets(fails, n) for n in (1, 2))
    assert (one.status, one.reason) == (two.status, two.reason)
    assert one.status == ("ok" if fails == "nothing" else fails)
    assert sim1.ticks == sim2.ticks
    assert mapper1.stamps == mapper2.stamps
    for name in ("truth", "estimates", "commands"):
        assert list(getattr(one, name)) == list(getattr(two, name))
    np.testing.assert_array_equal(one.stamps, two.stamps)


def test_an_error_of_the_driver_comes_after_the_ticks_before_it() -> None:
    for threads in (1, 2):
        sim, mapper = Puppet("driver", 40), SlowPuppet()
        with pytest.raises(ValueError, match="a bug"):
            drive(sim, sim, under_test(mapper, threads), 4.0)  # type: ignore[arg-type]
        assert len(mapper.stamps) == 40


def test_a_simulation_that_is_ahead_stays_within_its_limit() -> None:
    sim, mapper = Puppet("nothing", 0), SlowPuppet(0.005)
    taken = Drive(sim, sim, under_test(mapper), 4.0)  # type: ignore[arg-type]
    steps = iter(taken)
    for _ in range(50):
        next(steps)
        assert sim.ticks <= len(taken.log.truth) + loop.MOST_AHEAD
    assert sim.ticks > len(taken.log.truth) + 5
    taken.look_ahead = False
    while not taken.caught_up:
        next(steps)
    assert sim.ticks == len(taken.log.truth) == len(taken.log.commands) + 1


def test_a_drive_of_two_threads_stops_at_its_wall_limit() -> None:
    log, sim, mapper = puppets("nothing", 2, wall_limit=0.05)
    assert log.status == "wall limit"
    assert sim.ticks == len(log.truth) == len(mapper.stamps) < 101
    assert f"for {sim.time:.1f} of 4 simulated seconds" in log.reason


def test_a_driver_that_waits_for_the_mapper_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"driver frontier waits .* --threads 1, got 2"):
        RunConfig(source="simple", driver="frontier", threads=2)
    with pytest.raises(ConfigError, match=r"threads must be within \[1, 2\]"):
        RunConfig(source="simple", threads=3)


def test_one_thread_is_in_no_name() -> None:
    assert RunConfig(source="simple", threads=1).digest == RunConfig(source="simple").digest
    assert RunConfig(source="simple", threads=2).digest != RunConfig(source="simple").digest


def test_workers_drive_with_two_threads(tmp_path: Path) -> None:
    config = RunConfig(source="simple", seconds=2, threads=2)
    given = SlamExperiment(config)
    (outcome,) = Processes(jobs=1).run([given], tmp_path, lambda name: no_progress)
    assert outcome.status == "ok"
    here = run(replace(config, threads=1), out=tmp_path)
    assert here.folder is not None
    assert read_record(tmp_path / given.name)["rtf"]["mapper_in"] == "process"
    for name in ("truth.tum", "estimate.tum", "map.pgm"):
        assert (tmp_path / given.name / name).read_bytes() == (here.folder / name).read_bytes()
