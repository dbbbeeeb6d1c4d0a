"""Where commands speak: results on stdout, progress and complaints on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

out, err = Console(), Console(stderr=True)

RUN_FAILED, BAD_INPUT, INTERRUPTED = 3, 2, 130
"""Exit codes, beside 0 for success."""


@contextmanager
def work_bar(description: str) -> Iterator[Callable[[str, float], None]]:
    """Show a bar while work goes on; what is yielded takes a description and the share that is done."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task(description, total=None)

        def tell(description: str, share: float) -> None:
            bar.update(task, description=description, total=1.0, completed=share)

        yield tell
