"""Commands about runs: `validate`."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lirs_validation.cli import sweep_help as word
from lirs_validation.cli.arguments import SOURCE_HELP
from lirs_validation.cli.build_options import with_build_options
from lirs_validation.cli.console import RUN_FAILED, err, out
from lirs_validation.config import SourceOptions
from lirs_wct.errors import ConfigError, OutputError

if TYPE_CHECKING:
    from lirs_validation.sweep.engines.base import Executor
    from lirs_validation.sweep.sweep import Sweep

FEW = 10
"""Folders that are listed one by one."""


@with_build_options
def validate(
    sources: Annotated[list[str] | None, typer.Argument(help=SOURCE_HELP)] = None,
    suite: word.SuiteName = None,
    robot: word.Robots = None,
    mapper: word.Mappers = None,
    lidar: word.Lidars = None,
    terrain: word.Terrains = None,
    rays: word.RayKinds = None,
    seconds: word.Seconds = None,
    seed: word.Seed = None,
    seeds: word.Seeds = None,
    wall_limit: word.WallLimit = None,
    engine: word.EngineName = None,
    jobs: word.Jobs = None,
    address: word.Address = None,
    cell_timeout: word.CellTimeout = None,
    cell_memory: word.CellMemory = None,
    retry_failed: word.RetryFailed = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the runs' folders.")] = Path(
        "out"
    ),
    *,
    options: SourceOptions,
) -> None:
    """Drive robots through worlds with SLAM running, and evaluate map, trajectory and speed.

    Run again, the same command goes on where it was interrupted.
    """
    from lirs_validation.cli.sweep_options import axes_experiments, seeds_of, suite_experiments
    from lirs_validation.sweep.engines.base import Limits
    from lirs_validation.sweep.engines.factory import make_executor
    from lirs_validation.sweep.manifest import Manifest
    from lirs_validation.sweep.sweep import Sweep

    chosen = seeds_of(seed, seeds)
    axes = {"robot": robot, "mapper": mapper, "lidar": lidar, "terrain": terrain, "rays": rays}
    if suite is not None:
        others = {f"--{axis}": given is not None for axis, given in axes.items()}
        others |= {"sources": bool(sources), "options of build": options != SourceOptions()}
        experiments = suite_experiments(suite, others, chosen, seconds, wall_limit)
    elif sources:
        experiments = axes_experiments(sources, axes, chosen, seconds, wall_limit, options)
    else:
        raise ConfigError("nothing to validate: name a source (simple, a picture, a map, ...) or a --suite")
    memory = None if cell_memory is None else cell_memory * 1e9
    executor = make_executor(
        engine, jobs=jobs, address=address, limits=Limits(seconds=cell_timeout, memory=memory)
    )
    manifest = Manifest(command=shlex.join(["lirs-wct", *sys.argv[1:]]), suite=suite)
    sweep = Sweep(experiments, output, manifest=manifest, retry_failed=retry_failed)
    _run(sweep, executor)


def _run(sweep: Sweep, executor: Executor) -> None:
    """Run what is pending; show what there is then, also after Ctrl-C."""
    from lirs_validation.cli.progress import run_with_progress

    if sweep.kept:
        again = f"; {len(sweep.pending)} to run" if sweep.pending else ""
        err.print(f"kept {sweep.kept} of {len(sweep.experiments)} from before{again}", highlight=False)
    try:
        for _ in run_with_progress(sweep, executor, err):
            pass
    finally:
        _show(sweep)
    if sweep.unwritten:
        name, reason = next(iter(sweep.unwritten.items()))
        raise OutputError(f"{reason} ({len(sweep.unwritten)} not written, {name} among them; run it again)")
    if sweep.failed:
        raise typer.Exit(RUN_FAILED)


def _show(sweep: Sweep) -> None:
    from lirs_validation.cli.sweep_tables import sweep_tables

    if not sweep.outcomes:
        return
    for table in sweep_tables(sweep):
        out.print(table)
    folders = [sweep.out / found.name for found in sweep.experiments if found.name in sweep.outcomes]
    for folder in folders if len(folders) <= FEW else [sweep.out]:
        out.print(f"{folder}", soft_wrap=True, highlight=False)
