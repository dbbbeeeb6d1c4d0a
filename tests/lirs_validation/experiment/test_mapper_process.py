"""A mapper's process: what is asked of it, and how it ends."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lirs_envs.robots.robot import Twist, make_robot
from lirs_validation import RunConfig, read_record, validate
from lirs_validation.experiment.drive_log import Tick
from lirs_validation.experiment.loop import drive
from lirs_validation.experiment.mapper_loading import mapper_named
from lirs_validation.experiment.mapper_process import BATCH, MapperProcess
from lirs_validation.experiment.mapper_under_test import MapperUnderTest
from lirs_validation.experiment.run import prepare
from lirs_validation.experiment.scenario import build_scenario
from lirs_wct.errors import ConfigError, MapperError, SourceError
from lirs_wct.geometry.pose import Pose2, Pose3
from tests.lirs_validation.experiment.mapper_processes import mapper_processes

OWN = """
import os, signal, time
from slam_baselines.hector.mapper import HectorMapper

class Dying(HectorMapper):
    how = "os.kill(os.getpid(), signal.SIGKILL)"
    def update(self, scan, odometry, imu):
        if scan.stamp > 2.5: exec(self.how)  # the drive before the clock starts takes 2 s
        return super().update(scan, odometry, imu)

class Leaving(Dying):
    how = "os._exit(7)"

class Hanging(Dying):
    how = "open('hangs', 'w').close(); time.sleep(60)"
"""
SCRIPT = """
print("imported")
from lirs_validation import validate
from slam_baselines.hector.mapper import HectorMapper
class Own(HectorMapper):
    pass
for mapper in {mappers}:
    run = validate("simple", mapper=mapper, seconds=1, threads=2)
    print(run.record.rtf["mapper_in"], run.record.status, run.record.trajectory["ate_rmse"])
"""


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_slam.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_slam", raising=False)


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def until(found: Callable[[], bool], seconds: float) -> None:
    end = time.monotonic() + seconds
    while not found():
        assert time.monotonic() < end
        time.sleep(0.05)


def gone(pid: int) -> bool:
    try:
        return "Z" in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True


def test_a_script_needs_no_guard_and_its_own_class_needs_a_module() -> None:
    Path("script.py").write_text(SCRIPT.format(mappers=["hector", "__main__:Own"]))
    ran = subprocess.run(
        [sys.executable, "script.py"], capture_output=True, text=True, env=environment(), check=False
    )
    assert [line.split()[0] for line in ran.stdout.splitlines()] == ["imported", "process"]
    assert "ConfigError: mapper '__main__:Own': " in ran.stderr


@pytest.mark.parametrize(
    ("mapper", "how"),
    [("Dying", "signal SIGKILL; the system may have lacked memory"), ("Leaving", "exit code 7")],
)
def test_a_process_that_dies_is_told_in_a_line(mapper: str, how: str) -> None:
    with pytest.raises(MapperError) as raised:
        validate("simple", mapper=f"own_slam:{mapper}", seconds=5, threads=2, out="out")
    assert str(raised.value) == f"mapper 'own_slam:{mapper}': its process ended ({how})"
    assert not mapper_processes()
    assert not Path("out").exists()


def test_a_process_that_dies_before_a_batch_is_sent_keeps_nobody_waiting() -> None:
    (observation,) = validate("simple", seconds=1).log.observations[:1]
    process = MapperProcess(RunConfig(source="simple"), look_ahead=True)
    process.wait_until_ready()
    process._process.kill()
    process._process.wait()
    for _ in range(BATCH - 1):
        process._give(observation)
    with pytest.raises(MapperError, match="its process ended"):
        process._give(observation)
    assert process._answered
    with pytest.raises(MapperError, match="its process ended"):
        process._answer()


def test_an_interrupted_kernel_does_not_wait_for_the_mapper() -> None:
    (observation,) = validate("simple", seconds=1).log.observations[:1]
    process = MapperProcess(RunConfig(source="simple"), look_ahead=True)
    process.wait_until_ready()
    os.kill(process._process.pid, signal.SIGSTOP)
    late = threading.Timer(5.0, process._process.kill)
    late.start()

    def ticks() -> Iterator[Tick]:
        yield Tick(observation, Pose3(), 0.0)
        # As a compiled kernel raises it.
        raise SystemError("CPUDispatcher returned a result with an exception set") from KeyboardInterrupt()

    with pytest.raises(SystemError), closing(process):
        list(process.follow(ticks(), lambda pending: True))
    late.cancel()


def test_a_process_that_cannot_be_started_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(MapperError, match="mapper 'hector': its process cannot be started"):
        validate("simple", seconds=1, threads=2)


def test_nothing_is_left_of_a_mapper_that_cannot_be_made() -> None:
    with pytest.raises(ConfigError, match="no class 'Missing'") as kept:
        MapperProcess(RunConfig(source="simple", mapper="own_slam:Missing"))
    assert kept.tb is not None
    assert not mapper_processes()


def test_nothing_is_left_of_a_run_whose_world_cannot_be_built() -> None:
    with pytest.raises(SourceError, match="nowhere"):
        validate("nowhere.png", seconds=1, threads=2)
    assert not mapper_processes()


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_end_of_the_program_is_that_of_a_mapper_that_hangs(sent: signal.Signals) -> None:
    command = [sys.executable, "-m", "lirs_validation", "validate", "simple", "--mapper", "own_slam:Hanging"]
    # A shell's background jobs ignore Ctrl-C, and their children inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    program = subprocess.Popen(
        [*command, "--seconds", "5", "--threads", "2", "-o", "out"],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    until(lambda: bool(mapper_processes(program.pid)), 240)
    (mapper,) = mapper_processes(program.pid)
    until(Path("hangs").exists, 240)
    os.kill(program.pid, sent)
    said = program.communicate(timeout=120)[0]
    until(lambda: gone(mapper), 5)
    assert "Traceback" not in said
    assert not [path for path in Path("out").glob("*") if path.is_dir()]


def test_memory_and_processor_time_are_of_both_processes() -> None:
    config = RunConfig(source="simple", seconds=3)
    one, two = (validate("simple", mapper="hector", seconds=3, threads=n).record.cost for n in (1, 2))
    ready = prepare(replace(config, threads=2))
    with closing(ready.mapper):
        before = ready.mapper.cost()
        log = drive(ready.simulation, ready.driver, ready.mapper, 3.0)
        after = ready.mapper.cost()
    assert before.peak_memory is not None
    assert before.peak_memory > 50e6
    assert two["peak_memory"] > one["peak_memory"] + 50e6
    assert after.cpu_seconds - before.cpu_seconds > 0.7 * sum(log.mapper_seconds) / 2


def test_a_process_answers_as_the_mapper_does_and_begins_anew() -> None:
    config = RunConfig(source="simple", mapper="gmapping", seconds=2)
    simulation = build_scenario(config).simulation(make_robot("husky"))
    observations = [simulation.reset(Pose2())]
    observations += [simulation.advance(Twist(0.5, 0.2)) for _ in range(20)]
    here = MapperUnderTest(lambda: mapper_named("gmapping", config.seed), "gmapping")
    expected = [here.observe(observation).pose for observation in observations]
    with closing(MapperProcess(config)) as process:
        process.wait_until_ready()
        for _ in range(2):
            process.restart()
            assert [process.observe(observation).pose for observation in observations] == expected
            assert process.lost is here.lost
            np.testing.assert_array_equal(process.map().log_odds, here.map().log_odds)
            np.testing.assert_array_equal(process.trajectory().positions, here.trajectory().positions)
            assert process.stats.counts == here.stats.counts


def test_two_processes_at_a_time_in_one_program() -> None:
    """As on the page, where several people drive."""
    told: list[str] = []

    def run(seed: int) -> None:
        told.append(validate("simple", seconds=1, seed=seed, threads=2).record.rtf["mapper_in"])

    threads = [threading.Thread(target=run, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert told == ["process", "process"]


def test_a_process_is_told_of_no_attitude() -> None:
    one, two = (validate("simple", seconds=2, attitude="none", threads=n, out=f"out{n}") for n in (1, 2))
    assert one.folder is not None
    assert two.folder is not None
    assert (one.folder / "estimate.tum").read_bytes() == (two.folder / "estimate.tum").read_bytes()
    assert read_record(two.folder)["rtf"]["mapper_in"] == "process"
