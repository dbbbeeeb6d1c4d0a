"""Progress in a log file: a line every ten seconds, none in a terminal."""

import io
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from rich.console import Console

from lirs_validation.cli import progress as module
from lirs_validation.cli.progress import (
    LINE_PERIOD,
    ProgressNotes,
    note,
    progress_bar,
    run_with_progress,
    say,
)
from lirs_validation.config import RunConfig
from lirs_validation.sweep.sweep import Outcome, ProgressOf, Sweep, SweepTask, TimeLeft
from lirs_validation.sweep.tasks import RunTask


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_line_every_ten_seconds() -> None:
    clock, file = Clock(), io.StringIO()
    notes = ProgressNotes(Console(file=file), clock)
    for second in range(35):
        clock.now = float(second)
        notes.observe("dunes", "build", "dunes: [building]", second / 35)
    assert file.getvalue().splitlines() == [f"dunes: [building], {k / 35:.0%}" for k in (10, 20, 30)]


def test_a_terminal_gets_none() -> None:
    clock, file = Clock(), io.StringIO()
    notes = ProgressNotes(Console(file=file, force_terminal=True), clock)
    clock.now = 2 * LINE_PERIOD
    notes.observe("dunes", "build", "dunes", 0.5)
    assert file.getvalue() == ""


def test_a_bar_without_terminal_writes_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LINE_PERIOD", 0.0)
    file = io.StringIO()
    with progress_bar("dunes", Console(file=file)) as progress:
        progress("drive", 0.25)
    assert file.getvalue() == "dunes: driving, 25%\n"


def wait_for(file: io.StringIO) -> str:
    """Text of a file once there is some, at the latest after five seconds."""
    end = time.monotonic() + 5
    while not file.getvalue() and time.monotonic() < end:
        time.sleep(0.01)
    return file.getvalue()


def test_a_long_compilation_is_explained_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SLOW_COMPILATION", 0.05)
    file = io.StringIO()
    notes = ProgressNotes(Console(file=file))
    for work in ("a", "b"):
        notes.observe(work, "compile", work, 0.0)
    told = wait_for(file)
    notes.observe("c", "compile", "c", 0.0)
    time.sleep(0.2)
    assert file.getvalue() == told == "compiling kernels: slow the first time, then cached\n"


def test_a_short_compilation_is_not_mentioned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SLOW_COMPILATION", 0.2)
    file = io.StringIO()
    with progress_bar("dunes", Console(file=file)) as progress:
        progress("compile", 0.0)
        progress("drive", 0.1)
        time.sleep(0.3)
        progress("compile", 0.2)
    time.sleep(0.3)
    assert file.getvalue() == ""


def test_lines_are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    """Brackets in a path were taken for markup."""
    say(f"runs/[bold]/{'a' * 300}")
    note("map[1].yaml: [red]")
    assert capsys.readouterr() == (f"runs/[bold]/{'a' * 300}\n", "map[1].yaml: [red]\n")


def test_a_sweep_tells_the_time_left_once_it_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LINE_PERIOD", 0.0)
    clock, file = Clock(), io.StringIO()

    class Engine:
        def run(self, tasks: Sequence[SweepTask], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
            for task in tasks:
                progress_of(task.name)("build", 0.0)
                clock.now += 40.0
                progress_of(task.name)("drive", 0.5)
                clock.now += 60.0
                yield Outcome(task=task.name, status="ok", written=True)

    tasks = [RunTask(RunConfig(source="simple", mapper="own:Slow", seed=seed)) for seed in (1, 2, 3)]
    monkeypatch.setattr(RunTask, "check", lambda self: None)
    sweep = Sweep(tasks, tmp_path)
    sweep.time_left = TimeLeft(tasks, clock)
    assert len(list(run_with_progress(sweep, Engine(), Console(file=file, width=200)))) == 3
    left = [line.partition("%")[2] for line in file.getvalue().splitlines() if "driving" in line]
    assert left == ["", ", 3 min left", ", 60 s left"]
