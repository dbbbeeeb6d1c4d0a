"""The commands `falsify`, `tune` and `twin`."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from lirs_extensions.search.options import FalsifyOptions, TuneOptions
from lirs_validation.cli.commands.map import Log
from lirs_validation.cli.progress import err, out, progress_bar
from lirs_validation.config import RunConfig
from lirs_validation.map_config import MapConfig
from lirs_wct import BuildOptions, ConfigError

Failures = Annotated[Path, typer.Option("-o", "--output", help="Folder for cases, page and archive.")]
Tuned = Annotated[Path, typer.Option("-o", "--output", help="Folder for tuned values, table and archive.")]
TuneSource = Annotated[str, typer.Argument(metavar="SOURCE", help="World, picture, map or laser log.")]
Lidar = Annotated[str, typer.Option(help="Preset whose data sheet the log is compared with.")]
Replayed = Annotated[
    str, typer.Option("--replay", metavar="NAMES|all|none", help="Mappers of the log and its simulation.")
]
Draws = Annotated[
    int, typer.Option(min=1, help="Simulated logs with different random numbers; errors are their medians.")
]
TwinOutput = Annotated[Path, typer.Option("-o", "--output", help="Folder for the result's folder.")]


def falsify(output: Failures = Path("falsify"), *, options: FalsifyOptions) -> None:
    """Search for the easiest terrain, drive and sensor degradation on which a method fails.

    Each case fails with at least 4 of 5 new seeds and is reduced to its cause. The same command resumes.
    """
    from lirs_extensions.search.case_search import process_pool, require_cma
    from lirs_extensions.search.falsify import search
    from lirs_extensions.search.falsify.drives import CaseDrives, check_methods, search_limits
    from lirs_extensions.search.falsify.results import conclusion, write_results

    limits = search_limits(options)
    check_methods(options)
    if options.search == "cma":
        require_cma()
    with process_pool(options.jobs) as pool:
        drives = CaseDrives(options, limits, output, pool)
        found = search.falsify(drives, lambda line: err.print(line, highlight=False, soft_wrap=True))
    page = write_results(output, drives, found, shlex.join(["lirs-wct", *sys.argv[1:]]))
    for name in (page, *(output / f"case-{k}" for k in range(1, len(found) + 1))):
        out.print(f"{name}", soft_wrap=True, highlight=False)
    for sentence in conclusion(drives, found):
        out.print(sentence, soft_wrap=True, highlight=False, markup=False)


def tune(
    source: TuneSource,
    output: Tuned = Path("tune"),
    *,
    run: Annotated[dict[str, Any], RunConfig],
    tuning: TuneOptions,
    build: BuildOptions,
) -> None:
    """Search for parameters of a mapper that suit a world or log; print them by their ROS names.

    The result is compared with the defaults on unseen seeds. The same command resumes.
    """
    from lirs_extensions.search.case_search import process_pool, require_cma
    from lirs_extensions.search.tune import search

    target = _tune_target(source, run, tuning, build)
    limits = None if tuning.limits is None else Path(tuning.limits)
    space = search.search_space(target.mapper, target.parameters, limits)
    if tuning.search == "cma":
        require_cma()
    with process_pool(tuning.jobs) as pool:
        drives = search.TuneDrives(target, tuning, space, output, pool)
        tuned = search.tune(drives, lambda line: err.print(line, highlight=False, soft_wrap=True))
        found = search.compare(drives, tuned)
    paths = search.write_results(output, drives, tuned, found)
    out.print(search.conclusion(drives, tuned, found), soft_wrap=True, highlight=False, markup=False)
    for line in (*search.parameters_table(drives, tuned).as_markdown().splitlines(), *map(str, paths)):
        out.print(line, soft_wrap=True, highlight=False, markup=False)
    out.print(f"again: {search.again(drives, tuned)}", soft_wrap=True, highlight=False, markup=False)


def _tune_target(
    source: str, run: dict[str, Any], tuning: TuneOptions, build: BuildOptions
) -> RunConfig | MapConfig:
    """Return the run or the mapping whose mapper is tuned.

    Raises:
        ConfigError: the options give several runs, or an option does not suit the source.
        WctError: the source or a name cannot be used.
    """
    from lirs_validation.sweep.experiment import SlamExperiment
    from lirs_validation.sweep.suites import cross
    from lirs_wct.sources.options import SourceKind
    from lirs_wct.sources.source import find_source

    configs = cross(source, build=build, **run)
    if len(configs) != 1:
        raise ConfigError(f"tune takes one robot, mapper, seed, ..., got {len(configs)} combinations")
    (config,) = configs
    if find_source(source, build).kind is SourceKind.LOG:
        legal = {name: run[name][0] for name in ("mapper", "parameters", "seed", "attitude") if name in run}
        if set(run) - set(legal):
            raise ConfigError(f"{source}: is a log, which takes no --{min(set(run) - set(legal))}")
        return MapConfig(log=source, relations=tuning.relations, reference=tuning.reference, **legal)
    if tuning.relations or tuning.reference:
        raise ConfigError(f"{source}: --relations and --reference are for logs, this is none")
    SlamExperiment(config).check()
    return config


def twin(
    log: Log,
    output: TwinOutput = Path("out"),
    lidar: Lidar = "lms200",
    replay: Replayed = "all",
    draws: Draws = 1,
    *,
    given: Annotated[dict[str, Any], MapConfig],
) -> None:
    """Compare a log with its simulation: twin.html, and fitted noise.yaml for --noise."""
    from lirs_extensions.search.twin.replay import parse_mappers
    from lirs_extensions.search.twin.twin import run_twin

    config = MapConfig(log=log, **given)
    with progress_bar(log, err) as progress:
        result, folder = run_twin(
            config,
            lidar=lidar,
            seed=config.seed,
            out=output,
            replayed=parse_mappers(replay),
            draws=draws,
            command=shlex.join(["lirs-wct", *sys.argv[1:]]),
            progress=progress,
        )
    for sentence in result.sentences:
        out.print(sentence, soft_wrap=True, highlight=False)
    out.print(f"{folder / 'twin.html'}", soft_wrap=True, highlight=False)
