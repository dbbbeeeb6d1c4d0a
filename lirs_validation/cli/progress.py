"""Output of commands: exit codes, results on stdout, progress and errors on stderr."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from functools import partial
from threading import Timer
from typing import TYPE_CHECKING

from click.exceptions import Exit
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress as ProgressBar,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from lirs_validation.cli.exit_codes import ExitCode
from lirs_wct import OutputError, Progress

if TYPE_CHECKING:
    from lirs_validation.config import EngineOptions
    from lirs_validation.sweep.sweep import Executor, Outcome, Sweep


FILE_COLUMNS = 200
"""Columns of a file or a pipe, which have no width of their own unless COLUMNS says one."""
out = Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else FILE_COLUMNS)
err = Console(stderr=True)

STEPS = {
    "read": "reading",
    "build": "building",
    "plan": "planning",
    "compile": "compiling",
    "drive": "driving",
    "map": "mapping",
    "compare": "comparing",
    "evaluate": "evaluating",
    "draw": "drawing",
    "collide": "colliding",
}
"""Steps as they are shown; any other stands as it is."""
SLOW_COMPILATION = 2.0
"""Seconds of compilation after which a line explains it."""
LINE_PERIOD = 10.0
"""Seconds between two lines of progress where no terminal shows a bar."""


def say(text: object) -> None:
    """Print a line of results as it is."""
    out.print(str(text), markup=False, highlight=False, soft_wrap=True)


def note(text: object, style: str | None = None) -> None:
    """Print a remark or an error as it is."""
    err.print(str(text), markup=False, highlight=False, soft_wrap=True, style=style)


def duration_text(seconds: float) -> str:
    """Return a duration in its largest unit."""
    if seconds < 3600.0:
        return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


def command_line() -> str:
    """Return the command of this process, quoted for a shell."""
    return shlex.join(["lirs-wct", *sys.argv[1:]])


def run_sweep(sweep: Sweep, engine: EngineOptions, show: Callable[[], None]) -> None:
    """Run a sweep: skip finished runs, then call `show`, also when interrupted."""
    from lirs_validation.sweep.tasks import SUITES, make_executor

    executor = make_executor(engine)
    if sweep.suite in SUITES and engine.jobs not in (None, 1):
        note("concurrent runs give no RTF, which the paper's tables hold: leave out --jobs", style="yellow")
    if sweep.kept:
        again = f"; {len(sweep.pending)} to run" if sweep.pending else ""
        note(f"kept {sweep.kept} of {len(sweep.tasks)} from before{again}")
    left = sweep.time_left.seconds(engine.jobs or 1)
    if len(sweep.pending) > 1 and left is not None:
        note(f"{len(sweep.pending)} runs: about {duration_text(left)} on an idle machine")
    try:
        for _ in run_with_progress(sweep, executor):
            pass
    finally:
        show()
    if sweep.unwritten:
        name, reason = next(iter(sweep.unwritten.items()))
        raise OutputError(f"{reason} ({len(sweep.unwritten)} not written, {name} among them; run it again)")
    if sweep.failed:
        raise Exit(ExitCode.RUN_FAILED)


class ProgressNotes:
    """Lines of progress where no bar is shown, and one about a long compilation."""

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self._console, self._clock = console, clock
        self._due = clock() + LINE_PERIOD
        self._compilations: dict[str, Timer] = {}
        self._explained = False

    def observe(self, work: str, step: str, text: str, share: float, left: str = "") -> None:
        """Take in a step of some work; write text and time left after a while."""
        if step != "compile":
            self.end(work)
        elif work not in self._compilations and not self._explained:
            timer = self._compilations[work] = Timer(SLOW_COMPILATION, self._explain)
            timer.daemon = True
            timer.start()
        if not self._console.is_terminal and self._clock() >= self._due:
            self._due = self._clock() + LINE_PERIOD
            text = f"{text}, {share:.0%}{left and f', {left}'}"
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def end(self, work: str) -> None:
        """End the compilation of a piece of work."""
        if work in self._compilations:
            self._compilations.pop(work).cancel()

    def close(self) -> None:
        """End all compilations."""
        for work in tuple(self._compilations):
            self.end(work)

    def _explain(self) -> None:
        if not self._explained:
            self._explained = True
            self._console.print("compiling kernels: slow the first time, then cached", highlight=False)


@contextmanager
def progress_bar(work: str, console: Console = err) -> Iterator[Progress]:
    """Show a bar with the time left while a piece of work goes on."""
    with _bar(console, TimeRemainingColumn()) as bar, closing(ProgressNotes(console)) as notes:
        task = bar.add_task(work, total=None)

        def progress(step: str, share: float) -> None:
            description = f"{work}: {STEPS.get(step, step)}"
            bar.update(task, description=description, total=1.0, completed=share)
            notes.observe(work, step, description, share)

        yield progress


def run_with_progress(
    sweep: Sweep,
    executor: Executor,
    console: Console = err,
    watch: Callable[[str, str, float], None] = lambda name, step, share: None,
) -> Generator[Outcome]:
    """Run a sweep under a bar with the time left; `watch` gets name, step and share."""
    running: dict[str, float] = {}
    done, total, time_left = 0, len(sweep.pending), sweep.time_left
    column = TextColumn("{task.fields[left]}") if total > 1 else TimeRemainingColumn()
    with _bar(console, column) as bar, closing(ProgressNotes(console)) as notes:
        task = bar.add_task("", total=float(total), left="")

        def show(name: str, step: str) -> None:
            seconds = time_left.seconds() if total > 1 else None
            completed = done + sum(running.values())
            left = "" if seconds is None else f"{duration_text(seconds)} left"
            text = f"{done}/{total} " * (total > 1) + f"{name}: {STEPS.get(step, step)}"
            bar.update(task, description=text, completed=completed, left=left)
            notes.observe(name, step, text, completed / total, left)

        def progress(name: str, step: str, share: float) -> None:
            watch(name, step, share)
            running[name] = share
            time_left.begin(name)
            show(name, step)

        for outcome in sweep.run(executor, lambda name: partial(progress, name)):
            running.pop(outcome.task, None)
            time_left.end(outcome.task, outcome.compile_seconds)
            done += 1
            show(outcome.task, outcome.status)
            notes.end(outcome.task)
            yield outcome


def _bar(console: Console, *columns: ProgressColumn) -> ProgressBar:
    return ProgressBar(
        TextColumn("{task.description}", style="bold", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        *columns,
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
