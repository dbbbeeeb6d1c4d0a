"""A progress bar over one or many runs."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lirs_validation.sweep.engines.base import Executor
from lirs_validation.sweep.outcome import Outcome
from lirs_validation.sweep.sweep import Sweep

STAGES = {
    "build": "building",
    "plan": "planning",
    "compile": "compiling",
    "drive": "driving",
    "judge": "judging",
    "collide": "colliding",
}
LONG = 3600.0
"""The time left is estimated from the last so many seconds: cells take minutes, and differ."""


def run_with_progress(sweep: Sweep, executor: Executor, console: Console) -> Iterator[Outcome]:
    """Run a sweep's cells under a bar with the time left for all of them.

    Raises:
        WctError: the only cell cannot be run as it was asked for, or not be written.
    """
    bar = Progress(
        TextColumn("{task.description}", style="bold", markup=False),
        BarColumn(),
        TextColumn("{task.fields[done]}/{task.total:.0f}" if len(sweep.pending) > 1 else ""),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        speed_estimate_period=LONG,
    )
    running: dict[str, float] = {}
    done = 0
    with bar:
        task = bar.add_task("", total=float(len(sweep.pending)), done=0)

        def tell(name: str, stage: str, share: float) -> None:
            running[name] = share
            bar.update(task, description=f"{name}: {STAGES[stage]}", completed=done + sum(running.values()))

        for outcome in sweep.run(executor, tell):
            running.pop(outcome.cell, None)
            done += 1
            bar.update(task, completed=done + sum(running.values()), done=done)
            yield outcome
