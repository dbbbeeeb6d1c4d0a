"""How a command runs a sweep: what is kept is said, what there is is shown, also after Ctrl-C."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import typer

from lirs_validation.cli.console import RUN_FAILED, err
from lirs_wct.errors import OutputError

if TYPE_CHECKING:
    from lirs_validation.sweep.engines.base import Executor
    from lirs_validation.sweep.manifest import Manifest
    from lirs_validation.sweep.sweep import Sweep


def executor_for(
    engine: str | None,
    jobs: int | None,
    address: str | None,
    cell_timeout: float | None,
    cell_memory: float | None,
) -> Executor:
    """Return what runs a command's experiments, by its options: see `sweep_options`."""
    from lirs_validation.sweep.engines.base import Limits
    from lirs_validation.sweep.engines.factory import make_executor

    limits = Limits(seconds=cell_timeout, memory=None if cell_memory is None else cell_memory * 1e9)
    return make_executor(engine, jobs=jobs, address=address, limits=limits)


def manifest_of_command(suite: str | None = None) -> Manifest:
    """Return the manifest of the command that was typed."""
    from lirs_validation.sweep.manifest import Manifest

    return Manifest(command=shlex.join(["lirs-wct", *sys.argv[1:]]), suite=suite)


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
