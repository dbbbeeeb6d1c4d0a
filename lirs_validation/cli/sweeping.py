"""How a command runs a sweep: what is kept is said, what there is is shown, also after Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import typer

from lirs_validation.cli.console import RUN_FAILED, err
from lirs_wct.errors import OutputError

if TYPE_CHECKING:
    from lirs_validation.sweep.engines.base import Executor
    from lirs_validation.sweep.sweep import Sweep


def run_sweep(sweep: Sweep, executor: Executor, show: Callable[[], None]) -> None:
    """Run what is pending, then show.

    Raises:
        OutputError: a result cannot be written.
        typer.Exit: an experiment failed.
    """
    from lirs_validation.cli.progress import run_with_progress

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
        raise typer.Exit(RUN_FAILED)
