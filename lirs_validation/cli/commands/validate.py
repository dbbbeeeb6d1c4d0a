"""The commands `validate` and `record`: robots driven through worlds with SLAM running."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lirs_validation.cli import sweep_options as option
from lirs_validation.cli.arguments import SOURCE_HELP
from lirs_validation.cli.console import out
from lirs_validation.cli.sweeping import executor_for, manifest_of_command, run_sweep
from lirs_validation.cli.typer_options import with_build_options
from lirs_validation.config import SourceOptions

if TYPE_CHECKING:
    from lirs_validation.sweep.experiment import Experiment
    from lirs_validation.sweep.slam_experiment import SlamExperiment
    from lirs_validation.sweep.sweep import Sweep

FEW = 10
"""Folders that are listed one by one."""


def _validate(
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
    threads: option.Threads = None,
    seconds: option.Seconds = None,
    seed: option.Seed = None,
    seeds: option.Seeds = None,
    wall_limit: option.WallLimit = None,
    bag: option.Bag = False,
    storage: option.StorageName = None,
    sensors_only: option.SensorsOnly = False,
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
    given = locals()
    _run(_experiments(given), given, output)


def _record(*, folder: Path, **given: Any) -> None:
    """Record a drive as a ROS 2 bag: validate with --bag, into the folder that is named.

    The folder is that of the run, too: score, export and report take it. Of several runs it holds theirs.
    """
    from lirs_validation.sweep.slam_experiment import SlamExperiment

    experiments = _experiments({**given, "bag": True})
    if len(experiments) > 1 or not isinstance(experiments[0], SlamExperiment):
        _run(experiments, given, folder)
        return
    folder = folder if folder.name else folder.resolve()
    experiment = replace(experiments[0], folder=folder.name)
    _check_free(folder, experiment)
    _run((experiment,), given, folder.parent, listed=False)


def _signature() -> inspect.Signature:
    """Return what `record` takes: all that `validate` takes, but its folder is that of the bag."""
    into = Annotated[
        Path, typer.Option("-o", "--output", help="Folder of the bag; of several runs, for theirs.")
    ]
    own = inspect.Parameter("folder", inspect.Parameter.KEYWORD_ONLY, default=Path("run"), annotation=into)
    taken = inspect.signature(_validate, eval_str=True).parameters.values()
    return inspect.Signature([own if p.name == "output" else p for p in taken if p.name != "bag"])


_record.__signature__ = _signature()  # type: ignore[attr-defined]
validate, record = with_build_options(_validate), with_build_options(_record)


def _experiments(given: Mapping[str, Any]) -> tuple[Experiment, ...]:
    """Return the experiments that the options ask for."""
    axes = ("robot", "mapper", "lidar", "terrain", "rays", "attitude", "driver", "actors")
    found = option.read_experiments(
        given["sources"],
        given["suite"],
        {axis: given[axis] for axis in axes},
        option.read_seed_options(given["seed"], given["seeds"]),
        given["seconds"],
        given["wall_limit"],
        option.read_threads(given["threads"]),
        given["options"],
    )
    bags = {name: given[name] for name in ("bag", "storage", "sensors_only")}
    return option.recorded(found, **bags)


def _run(
    experiments: Sequence[Experiment], given: Mapping[str, Any], out: Path, *, listed: bool = True
) -> None:
    """Run experiments as the options say."""
    from lirs_validation.sweep.sweep import Sweep

    executor = executor_for(
        given["engine"], given["jobs"], given["address"], given["cell_timeout"], given["cell_memory"]
    )
    asked, retry = manifest_of_command(given["suite"]), given["retry_failed"]
    sweep = Sweep(experiments, out, manifest=asked, listed=listed, retry_failed=retry)
    run_sweep(sweep, executor, lambda: _show(sweep))


def _check_free(folder: Path, experiment: SlamExperiment) -> None:
    """Refuse a folder that holds something else than this very run: it would be replaced.

    Raises:
        OutputError: it does.
    """
    from lirs_validation.config import run_name
    from lirs_validation.record.run_record import read_record
    from lirs_wct.errors import OutputError, SourceError

    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    wanted = run_name(experiment.config, experiment.world)
    try:
        held = read_record(folder)["name"]
    except SourceError:
        raise OutputError(f"{folder}: holds something else than a run; choose another --output") from None
    if held != wanted:
        raise OutputError(f"{folder}: holds another run, {held}; choose another --output")


def _show(sweep: Sweep) -> None:
    from lirs_validation.report.tables.sweep_tables import sweep_tables

    if not sweep.outcomes:
        return
    for table in sweep_tables(sweep):
        out.print(table)
    folders = [sweep.out / found.name for found in sweep.experiments if found.name in sweep.outcomes]
    for folder in folders if len(folders) <= FEW else [sweep.out]:
        out.print(f"{folder}", soft_wrap=True, highlight=False)
