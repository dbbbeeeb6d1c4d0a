"""The command `validate`: robots driven through worlds with SLAM running, one run or a sweep."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lirs_validation.cli import sweep_options as option
from lirs_validation.cli.arguments import SOURCE_HELP
from lirs_validation.cli.console import out
from lirs_validation.cli.sweeping import run_sweep
from lirs_validation.cli.typer_options import with_build_options
from lirs_validation.config import SourceOptions

if TYPE_CHECKING:
    from lirs_validation.sweep.sweep import Sweep

FEW = 10
"""Folders that are listed one by one."""


@with_build_options
def validate(
    sources: Annotated[list[str] | None, typer.Argument(help=SOURCE_HELP)] = None,
    suite: option.SuiteName = None,
    robot: option.Robots = None,
    mapper: option.Mappers = None,
    lidar: option.Lidars = None,
    terrain: option.Terrains = None,
    rays: option.RayKinds = None,
    attitude: option.Attitudes = None,
    driver: option.Drivers = None,
    actors: option.Actors = None,
    seconds: option.Seconds = None,
    seed: option.Seed = None,
    seeds: option.Seeds = None,
    wall_limit: option.WallLimit = None,
    engine: option.EngineName = None,
    jobs: option.Jobs = None,
    address: option.Address = None,
    cell_timeout: option.CellTimeout = None,
    cell_memory: option.CellMemory = None,
    retry_failed: option.RetryFailed = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the runs' folders.")] = Path(
        "out"
    ),
    *,
    options: SourceOptions,
) -> None:
    """Drive robots through worlds with SLAM running, and evaluate map, trajectory and speed.

    The same command resumes an interrupted sweep.
    """
    from lirs_validation.sweep.engines.base import Limits
    from lirs_validation.sweep.engines.factory import make_executor
    from lirs_validation.sweep.manifest import Manifest
    from lirs_validation.sweep.sweep import Sweep

    axes = {
        "robot": robot,
        "mapper": mapper,
        "lidar": lidar,
        "terrain": terrain,
        "rays": rays,
        "attitude": attitude,
        "driver": driver,
        "actors": actors,
    }
    chosen = option.read_seed_options(seed, seeds)
    experiments = option.read_experiments(sources, suite, axes, chosen, seconds, wall_limit, options)
    limits = Limits(seconds=cell_timeout, memory=None if cell_memory is None else cell_memory * 1e9)
    executor = make_executor(engine, jobs=jobs, address=address, limits=limits)
    manifest = Manifest(command=shlex.join(["lirs-wct", *sys.argv[1:]]), suite=suite)
    sweep = Sweep(experiments, output, manifest=manifest, retry_failed=retry_failed)
    run_sweep(sweep, executor, lambda: _show(sweep))


def _show(sweep: Sweep) -> None:
    from lirs_validation.report.tables.sweep_tables import sweep_tables

    if not sweep.outcomes:
        return
    for table in sweep_tables(sweep):
        out.print(table)
    folders = [sweep.out / found.name for found in sweep.experiments if found.name in sweep.outcomes]
    for folder in folders if len(folders) <= FEW else [sweep.out]:
        out.print(f"{folder}", soft_wrap=True, highlight=False)
