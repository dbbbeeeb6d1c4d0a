"""Consoles and bars of commands: results on stdout, progress and errors on stderr."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
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

from lirs_wct.errors import OutputError
from lirs_wct.progress import Progress

if TYPE_CHECKING:
    from lirs_validation.config import EngineOptions
    from lirs_validation.sweep.engines import Executor
    from lirs_validation.sweep.experiment import Manifest, Outcome
    from lirs_validation.sweep.sweep import Sweep

WIDE = 200
"""Columns of a file or a pipe, which have no width of their own unless COLUMNS says one."""

out = Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else WIDE)
err = Console(stderr=True)

RUN_FAILED, BAD_INPUT, GATE_FAILED, INTERRUPTED = 3, 2, 4, 130
"""Exit codes, beside 0 for success."""


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
LONG = 3600.0
"""The time left is estimated from the last so many seconds: experiments take minutes, and differ."""
SLOW = 2.0
"""Seconds of compilation after which a line explains it."""
EVERY = 10.0
"""Seconds between two lines of progress where no terminal shows a bar."""


def manifest_of_command(suite: str | None = None) -> Manifest:
    """Return the manifest of this process's command line."""
    from lirs_validation.sweep.experiment import Manifest

    return Manifest(command=shlex.join(["lirs-wct", *sys.argv[1:]]), suite=suite)


def run_sweep(sweep: Sweep, engine: EngineOptions, show: Callable[[], None]) -> None:
    """Run a sweep: skip finished runs, then call `show`, also when interrupted.

    Raises:
        OutputError: a result cannot be written.
        Exit: an experiment failed.
    """
    from lirs_validation.sweep.sweep import make_executor

    executor = make_executor(engine)
    if sweep.kept:
        again = f"; {len(sweep.pending)} to run" if sweep.pending else ""
        err.print(f"kept {sweep.kept} of {len(sweep.experiments)} from before{again}", highlight=False)
    try:
        for _ in run_with_progress(sweep, executor, err):
            pass
    finally:
        show()
    if sweep.unwritten:
        name, reason = next(iter(sweep.unwritten.items()))
        raise OutputError(f"{reason} ({len(sweep.unwritten)} not written, {name} among them; run it again)")
    if sweep.failed:
        raise Exit(RUN_FAILED)


class ProgressLines:
    """Lines of progress in a log file; none in a terminal, which has the bar."""

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self._console, self._clock = console, clock
        self._due = clock() + EVERY

    def note(self, work: str, share: float) -> None:
        """Write a line if the last one is long ago."""
        if self._console.is_terminal or self._clock() < self._due:
            return
        self._due = self._clock() + EVERY
        self._console.print(f"{work}, {share:.0%}", highlight=False, markup=False, soft_wrap=True)


class CompileNote:
    """Line about a compilation that takes long, once per command."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._timers: dict[str, Timer] = {}
        self._told = False

    def observe(self, work: str, step: str) -> None:
        """Take in the step of a piece of work."""
        if step != "compile":
            self.end(work)
        elif work not in self._timers and not self._told:
            self._timers[work] = Timer(SLOW, self._tell)
            self._timers[work].daemon = True
            self._timers[work].start()

    def end(self, work: str) -> None:
        """End the compilation of a piece of work."""
        if work in self._timers:
            self._timers.pop(work).cancel()

    def close(self) -> None:
        """End all compilations."""
        for work in tuple(self._timers):
            self.end(work)

    def _tell(self) -> None:
        if not self._told:
            self._told = True
            self._console.print("compiling kernels: slow the first time, then cached", highlight=False)


@contextmanager
def progress_bar(work: str, console: Console) -> Iterator[Progress]:
    """Show a bar with the time left while a piece of work goes on."""
    lines, compilation = ProgressLines(console), CompileNote(console)
    with _bar(console) as bar, closing(compilation):
        task = bar.add_task(work, total=None)

        def progress(step: str, share: float) -> None:
            compilation.observe(work, step)
            description = f"{work}: {STEPS.get(step, step)}"
            bar.update(task, description=description, total=1.0, completed=share)
            lines.note(description, share)

        yield progress


def run_with_progress(sweep: Sweep, executor: Executor, console: Console) -> Generator[Outcome]:
    """Run a sweep's experiments under a bar with the time left for all of them.

    Raises:
        WctError: the only experiment cannot be run as it was asked for, or not be written.
    """
    many = len(sweep.pending) > 1
    running: dict[str, float] = {}
    done = 0
    lines, compilation, total = ProgressLines(console), CompileNote(console), len(sweep.pending)
    count = TextColumn("{task.fields[done]}/{task.total:.0f}" if many else "")
    with _bar(console, count) as bar, closing(compilation):
        task = bar.add_task("", total=float(len(sweep.pending)), done=0)

        def progress_of(name: str) -> Progress:
            def progress(step: str, share: float) -> None:
                running[name] = share
                compilation.observe(name, step)
                description, completed = f"{name}: {STEPS.get(step, step)}", done + sum(running.values())
                bar.update(task, description=description, completed=completed)
                lines.note(f"{done}/{total} {description}" if many else description, completed / total)

            return progress

        for outcome in sweep.run(executor, progress_of):
            running.pop(outcome.experiment, None)
            compilation.end(outcome.experiment)
            done += 1
            bar.update(task, completed=done + sum(running.values()), done=done)
            yield outcome


def _bar(console: Console, *columns: ProgressColumn) -> ProgressBar:
    return ProgressBar(
        TextColumn("{task.description}", style="bold", markup=False),
        BarColumn(),
        *columns,
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
        speed_estimate_period=LONG,
    )
