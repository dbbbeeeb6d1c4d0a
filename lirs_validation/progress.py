"""A progress bar over one or many runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lirs_validation.record import RunConfig
from lirs_validation.run import Run, run

STAGES = {
    "build": "building",
    "plan": "planning",
    "compile": "compiling",
    "drive": "driving",
    "judge": "judging",
}


def run_with_progress(configs: list[RunConfig], out: Path, console: Console) -> Iterator[Run]:
    """Run configs one after the other, since a shared processor spoils the RTF.

    Raises:
        WctError: a config cannot be run; the runs before it stand.
    """
    bar = Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    with bar:
        task = bar.add_task("", total=float(len(configs)))
        for done, config in enumerate(configs):

            def tell(stage: str, share: float, config: RunConfig = config, done: int = done) -> None:
                bar.update(task, description=f"{config.source}: {STAGES[stage]}", completed=done + share)

            yield run(config, out=out, report=tell)
