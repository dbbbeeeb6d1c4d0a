"""A sweep that is killed or interrupted: nothing half-written, nobody left behind, and it goes on."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from lirs_extensions.search.case_search import TrialArchive
from lirs_validation.cli.progress import run_with_progress
from lirs_validation.sweep.engines import Processes, WorkerPool
from lirs_validation.sweep.sweep import Executor, Serial, Sweep
from lirs_wct.errors import ConfigError, WctError
from lirs_wct.files import remove_leftovers
from lirs_wct.progress import Progress
from tests.lirs_validation.sweep.fake_experiments import FakeExperiment

ROOT = Path(__file__).resolve().parents[3]
SCRIPT = """
import sys
from pathlib import Path
from lirs_validation.cli.progress import run_with_progress
from lirs_validation.sweep.engines import Processes
from lirs_validation.sweep.sweep import Sweep
from tests.lirs_validation.sweep.fake_experiments import FakeExperiment

if __name__ == "__main__":
    notes, out = sys.argv[1:]
    manners = {"a": "good", "b": "hangs", "c": "good"}
    experiments = [FakeExperiment(name, notes, manner) for name, manner in manners.items()]
    list(Sweep(experiments, Path(out)).run(Processes(jobs=2)))
"""


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def lives(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks into /proc")
@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_sweep_goes_on(kill: signal.Signals, tmp_path: Path) -> None:
    notes, out = tmp_path / "notes", tmp_path / "out"
    notes.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(notes), str(out)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'envs'}"},
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    until(lambda: (out / "c").exists() and any(out.glob(".b.*/result")))
    process.send_signal(kill)
    process.wait(timeout=30)
    experiments = [
        FakeExperiment("a", str(notes)),
        FakeExperiment("b", str(notes)),
        FakeExperiment("c", str(notes)),
    ]
    until(lambda: not any(lives(pid) for experiment in experiments for pid in experiment.runs))
    if kill == signal.SIGINT:
        assert not any(out.glob(".*"))

    sweep = Sweep(experiments, out)
    assert not any(out.glob(".*"))
    assert sweep.kept == 2
    assert [outcome.task for outcome in sweep.run(Serial())] == ["b"]
    assert not sweep.failed
    assert [len(experiment.runs) for experiment in experiments] == [1, 2, 1]


def test_only_what_the_dead_were_writing_is_removed(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    swept = [f".my.{dead.pid}-0123abcd.map-s1", f".other.{dead.pid}-0123abcd"]
    swept.append(f".my.{os.getpid()}-0123abcd.map-s1")  # of an earlier process with this one's id
    spared = [f".my.{os.getppid()}-0123abcd.map-s1", f".thesis.{dead.pid}-0123abcd", ".my", "my.map-s1"]
    for name in swept + spared:
        (tmp_path / name).mkdir()
    remove_leftovers([tmp_path / "my.map-s1", tmp_path / "other"])
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(spared)


@dataclass(frozen=True)
class Halve:
    """A job that returns half a number and its process, and raises for odd ones."""

    number: int

    def __call__(self, progress: Progress) -> tuple[int, int]:
        if self.number % 2:
            raise ConfigError(f"{self.number}: is odd")
        return self.number // 2, os.getpid()


@dataclass(frozen=True)
class Loss:
    """A score of a search."""

    loss: float


def measure(number: int) -> Loss:
    return Loss(number / 4)


def die(number: int) -> Loss:
    os._exit(3)


@pytest.mark.slow
def test_a_worker_does_many_jobs_and_an_error_is_raised() -> None:
    with WorkerPool(1) as pool:
        ended = dict(pool.run([Halve(4), Halve(8)]))
        assert [half for half, _ in ended.values()] == [2, 4]  # type: ignore[misc]
        with pytest.raises(ConfigError, match=r"^3: is odd\n") as raised:
            list(pool.run([Halve(3), Halve(6)]))
        assert "test_engines.py" in raised.value.__notes__[0]
        assert len({pid for _, pid in (*ended.values(), *dict(pool.run([Halve(2)])).values())}) == 1  # type: ignore[misc]


@pytest.mark.slow
def test_a_search_keeps_the_order_of_its_trials_in_processes(tmp_path: Path) -> None:
    trials = [(f"{k}", (k,)) for k in range(8)]
    alone = TrialArchive(tmp_path / "alone.jsonl", Loss)
    with WorkerPool(2) as pool:
        shared = TrialArchive(tmp_path / "shared.jsonl", Loss, pool)
        assert shared.scores(measure, trials, "hector") == alone.scores(measure, trials, "hector")
        with pytest.raises(WctError, match="a process that drove hector died; the same command continues"):
            shared.scores(die, [("9", (9,))], "hector")
    assert (tmp_path / "shared.jsonl").read_bytes() == (tmp_path / "alone.jsonl").read_bytes()


class TooLate(KeyboardInterrupt):
    """Interrupt by the function that watches the progress."""


@pytest.mark.slow
@pytest.mark.parametrize("make", [Serial, partial(Processes, jobs=1)])
def test_a_task_that_its_watcher_stops_leaves_nothing_and_others_follow(
    make: Callable[[], Executor], tmp_path: Path
) -> None:
    executor = make()  # idle processes end with it

    def watch(name: str, step: str, share: float) -> None:
        if name == "hanging":
            raise TooLate

    notes, out = tmp_path / "notes", tmp_path / "out"
    notes.mkdir()
    tasks = [FakeExperiment(name, str(notes)) for name in ("first", "second")]
    assert [each.task for each in run_with_progress(Sweep(tasks[:1], out), executor)] == ["first"]
    hanging = FakeExperiment("hanging", str(notes), "hangs")
    with pytest.raises(TooLate):
        list(run_with_progress(Sweep([hanging], out, listed=False), executor, watch=watch))
    assert [each.task for each in run_with_progress(Sweep(tasks[1:], out), executor)] == ["second"]
    assert sorted(path.name for path in out.iterdir()) == ["first", "second", "sweep.json"]


@pytest.mark.slow
def test_an_idle_process_waits_for_the_next_sweep(tmp_path: Path) -> None:
    notes, out = tmp_path / "notes", tmp_path / "out"
    notes.mkdir()
    tasks = [FakeExperiment(name, str(notes)) for name in ("first", "second")]
    executor = Processes(jobs=1)
    for task in tasks:
        list(Sweep([task], out).run(executor))
    (process,) = tasks[0].runs
    assert tasks[1].runs == [process]
    del executor
    until(lambda: not lives(process))
