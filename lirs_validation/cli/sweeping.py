"""Sweeps of a command: skip finished runs, print the results, also when interrupted."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import typer

from lirs_validation.cli.console import RUN_FAILED, err
from lirs_wct.errors import OutputError

if TYPE_CHECKING:
    from lirs_validation.config import EngineOptions
    from lirs_validation.sweep.manifest import Manifest
    from lirs_validation.sweep.sweep import Sweep


def manifest_of_command(suite: str | None = None) -> Manifest:
    """Return the manifest of this process's command line."""
    from lirs_validation.sweep.manifest import Manifest

    return Manifest(command=shlex.join(["lirs-wct", *sys.argv[1:]]), suite=suite)


def run_sweep(sweep: Sweep, engine: EngineOptions, show: Callable[[], None]) -> None:
    """Run a sweep: skip finished runs, then call `show`, also when interrupted.

    Raises:
        OutputError: a result cannot be written.
        typer.Exit: an experiment failed.
    """
    from lirs_validation.cli.progress import run_with_progress
    from lirs_validation.sweep.engines.factory import make_executor

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
        raise typer.Exit(RUN_FAILED)
