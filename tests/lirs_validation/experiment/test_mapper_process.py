"""A mapper's process: what is asked of it, and how it ends."""

import os
import pickle
import shutil
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

from lirs_envs.sensing.sensors import Observation
from lirs_validation import RunConfig, validate
from lirs_validation.experiment.loading import own_source_file
from lirs_validation.experiment.mapper_under_test import (
    LocalMapper,
    MapperProcess,
    MapperUnderTest,
    SensorReadings,
    mapper_named,
)
from lirs_wct.errors import ConfigError, MapperError, SourceError
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import LaserScan
from tests.lirs_validation.experiment.puppets import mapper_processes

MADE = """
from types import SimpleNamespace
from lirs_validation.experiment.mapper_under_test import MapperProcess
def made(mapper):
    usual = {"seed": 1, "attitude": "imu", "parameters": "", "mapper_python": None}
    process = MapperProcess(SimpleNamespace(mapper=mapper, **usual))
    return process
"""
SCRIPT = """
print("imported", flush=True)
class Own: pass
made("own_mappers:Own")
print("ready", flush=True)
made("__main__:Own")
"""
HANGS = """
import pickle, sys
process = made("own_mappers:Hangs")
for readings in pickle.load(sys.stdin.buffer):
    process.observe(readings)
"""


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    monkeypatch.chdir(tmp_path)
    yield
    assert not mapper_processes()


def config(mapper: str) -> RunConfig:
    return RunConfig(source="simple", mapper=mapper)


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


def observe_all(mapper: MapperUnderTest, observations: list[Observation]) -> list[Pose2 | Pose3]:
    return [mapper.observe(observation).pose for observation in observations]


def test_a_script_needs_no_guard_and_its_own_class_needs_a_module() -> None:
    Path("script.py").write_text(MADE + SCRIPT)
    ran = subprocess.run(
        [sys.executable, "script.py"], capture_output=True, text=True, env=environment(), check=False
    )
    assert ran.stdout.split() == ["imported", "ready"]
    assert "ConfigError: mapper '__main__:Own': " in ran.stderr


@pytest.mark.parametrize(
    ("mapper", "message"),
    [
        ("Dies", "its process ended (signal SIGKILL; the system may have lacked memory)"),
        ("Leaves", "its process ended (exit code 7)"),
        ("Fails", "update() failed for the scan at 0.160 s: ValueError: no more"),
    ],
)
def test_a_process_that_fails_is_told_in_a_line(
    mapper: str, message: str, observations: list[Observation]
) -> None:
    with (
        closing(MapperProcess(config(f"own_mappers:{mapper}"))) as process,
        pytest.raises(MapperError) as raised,
    ):
        observe_all(process, observations)
    assert str(raised.value) == f"mapper 'own_mappers:{mapper}': {message}"
    if mapper == "Fails":  # where, in the other process
        assert "in act\n    raise ValueError" in raised.value.__notes__[0]


def test_a_process_that_cannot_be_started_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(MapperError, match="mapper 'own_mappers:Own': its process cannot be started"):
        validate("simple", seconds=1, mapper="own_mappers:Own")


def test_nothing_is_left_of_a_run_whose_world_cannot_be_built() -> None:
    with pytest.raises(SourceError, match="nowhere"):
        validate("nowhere.png", mapper="own_mappers:Own", seconds=1)
    assert not mapper_processes()


def test_a_mapper_that_hangs_ends_with_a_program_that_is_killed(observations: list[Observation]) -> None:
    command = [sys.executable, "-c", MADE + HANGS]
    program = subprocess.Popen(command, env=environment(), stdin=subprocess.PIPE)
    assert program.stdin is not None
    program.stdin.write(pickle.dumps([SensorReadings(o.scan, o.odometry, o.imu) for o in observations]))
    program.stdin.close()
    until(lambda: Path("hangs").exists() or program.poll() is not None, 60)
    (mapper,) = mapper_processes(program.pid)
    program.kill()
    program.wait()
    until(lambda: gone(mapper), 5)


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_the_end_of_the_command_is_that_of_a_mapper_that_hangs(sent: signal.Signals, room: str) -> None:
    # A shell's background jobs ignore Ctrl-C, and their children inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    words = ("validate", room, "--mapper", "own_mappers:Hangs", "--seconds", "5", "-o", "out")
    program = subprocess.Popen(
        [sys.executable, "-m", "lirs_validation", *words],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    until(lambda: Path("hangs").exists() or program.poll() is not None, 240)
    (mapper,) = mapper_processes(program.pid)
    program.send_signal(sent)
    said = program.communicate(timeout=120)[0]
    until(lambda: gone(mapper), 5)
    assert "Traceback" not in said
    assert not [path for path in Path("out").glob("*") if path.is_dir()]


def test_memory_and_processor_time_are_those_since_the_first_scan(observations: list[Observation]) -> None:
    with closing(MapperProcess(config("own_mappers:Works"))) as process:
        before = process.cost()
        observe_all(process, observations[:5])
        after = process.cost()
    assert before.peak_memory is not None
    assert after.peak_memory is not None
    assert after.peak_memory > before.peak_memory + 50e6
    assert before.cpu_seconds < 0.1 < after.cpu_seconds


@pytest.mark.parametrize("mapper", ["own_mappers:Own", pytest.param("gmapping", marks=pytest.mark.slow)])
def test_a_process_answers_as_the_mapper_does(mapper: str, observations: list[Observation]) -> None:
    here = LocalMapper(mapper_named(mapper, 1), mapper)
    expected = observe_all(here, observations)
    with closing(MapperProcess(config(mapper))) as process:
        assert observe_all(process, observations) == expected
        np.testing.assert_array_equal(process.map().log_odds, here.map().log_odds)
        np.testing.assert_array_equal(process.trajectory().positions, here.trajectory().positions)
        assert process.stats.counts == here.stats.counts


def test_two_processes_at_a_time_in_one_program(observations: list[Observation]) -> None:
    """As on the page, where several people drive."""
    told: list[int] = []

    def work() -> None:
        with closing(MapperProcess(config("own_mappers:Own"))) as process:
            observe_all(process, observations)
            told.append(process.stats.received)

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert told == [20, 20]


def observed(mapper: str) -> MapperProcess:
    """Return a mapper's process after the scan at which it acts."""
    process = MapperProcess(config(mapper))
    scan = LaserScan(np.ones(9, np.float32), -0.4, 0.1, 0.1, 9.0, 0.0)
    for k in range(6):
        process.observe(SensorReadings(replace(scan, stamp=0.1 * k), Pose2(0.1 * k), None))
    return process


@pytest.mark.skipif(sys.platform == "win32", reason="there is no fork")
def test_a_mapper_may_use_a_pool_of_processes() -> None:
    with closing(observed("own_mappers:Pooled")) as process:
        assert process.stats.received == 6


FORKS = """
import os, signal, sys, time
from lirs_validation.processes import end_with

end_with(os.getppid())
for _ in range(20):
    child = os.fork()
    if child == 0:
        time.sleep(60)
    os.kill(child, signal.SIGTERM)
    os.waitpid(child, 0)
os._exit(0)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no fork")
def test_a_child_that_is_ended_at_once_ends() -> None:
    """A child of a mapper's process lost the signal, and its pool waited for ever."""
    assert subprocess.run([sys.executable, "-c", FORKS], timeout=30, check=False).returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="there are no process groups")
def test_what_a_mapper_leaves_behind_ends_with_it() -> None:
    with closing(observed("own_mappers:LeavesChild")) as process:
        child = int(process.map().log_odds[0, 0])
        assert not gone(child)
    until(lambda: gone(child), 5.0)


def test_a_mapper_may_be_named_by_its_file(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "their_own.py").write_text("from helper_of_mine import Own\n\n\nclass Theirs(Own): ...\n")
    shutil.copy(Path(__file__).parent / "own_mappers.py", folder / "helper_of_mine.py")
    with closing(observed("mine/their_own.py:Theirs")) as process:
        assert process.stats.received == 6
    assert own_source_file("mine/their_own.py:Theirs") == Path("mine/their_own.py")
    with pytest.raises(ConfigError, match=r"mine/none\.py:Theirs'.*: mine/none\.py: no such file"):
        mapper_named("mine/none.py:Theirs", 1)
    with pytest.raises(ConfigError, match="their_own has no class 'Other'; classes with update: Own, Theirs"):
        mapper_named("mine/their_own.py:Other", 1)


@pytest.mark.slow
def test_a_mapper_of_a_file_may_spawn_processes(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    text = (Path(__file__).parent / "own_mappers.py").read_text().replace('"fork"', '"spawn"')
    (folder / "their_pool.py").write_text(text.replace("map(abs, [1, 2])", "map(twice, [1, 2])") + TWICE)
    with closing(observed("mine/their_pool.py:Pooled")) as process:
        assert process.stats.received == 6
    (folder / "json.py").write_text(text)
    with pytest.raises(ConfigError, match="json is a module of Python, the file needs another name"):
        mapper_named("mine/json.py:Pooled", 1)


TWICE = "\n\ndef twice(x):\n    return 2 * x\n"
