"""The commands `falsify`, `tune` and `twin`."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from lirs_extensions.search.options import FalsifyOptions, PoolOptions, TuneOptions
from lirs_validation.cli.command import OneSource, common
from lirs_validation.cli.commands.worlds import LogInOut
from lirs_validation.cli.progress import command_line, note, progress_bar, say
from lirs_validation.config import MapConfig, RunConfig, World
from lirs_wct import BuildOptions, ConfigError
from lirs_wct.option import Options, option, within


@dataclass(frozen=True, kw_only=True)
class FalsifyFolder(Options):
    """Results of `falsify`."""

    output: Path = option(Path("falsify"), "Folder for cases, page and archive.")


@dataclass(frozen=True, kw_only=True)
class TuneFolder(OneSource):
    """Source and results of `tune`."""

    output: Path = option(Path("tune"), "Folder for tuned values, table and archive.")


@dataclass(frozen=True, kw_only=True)
class TwinCommand(LogInOut, PoolOptions):
    """Log, lidar and replayed mappers of `twin`."""

    lidar: str = option("lms200", "Preset whose data sheet the log is compared with.", metavar="NAME")
    replay: str | None = option(
        None, "Mappers of the simulated logs; default: that of --mapper.", metavar="NAMES|all|none"
    )
    draws: int = option(20, "Simulated logs; their errors give the interval.", check=within("[3, 1000]"))


def falsify(folder: FalsifyFolder, options: FalsifyOptions) -> None:
    """Search for the easiest terrain, drive and sensor degradation on which a method fails.

    Each case fails with at least 4 of 5 new seeds and is reduced to its cause. The same command resumes.

    Examples:
    lirs-wct falsify --mapper hector --drives 150 --jobs 2 -o failures/
    lirs-wct falsify --policy go_to_goal --drives 60 -o failures/
    lirs-wct validate --suite failures/cases.yaml -o out/
    """
    from lirs_extensions.search.case_search import process_pool, require_cma
    from lirs_extensions.search.falsify import search
    from lirs_extensions.search.falsify.results import conclusion, write_results

    limits, output = search.search_limits(options), folder.output
    search.check_methods(options)
    if options.search == "cma":
        require_cma()
    with process_pool(options.jobs) as pool:
        drives = search.CaseDrives(options, limits, output, pool)
        found = search.falsify(drives, note)
    page = write_results(output, drives, found, command_line())
    _show(page, *(output / f"case-{k}" for k in range(1, len(found) + 1)), *conclusion(drives, found))


def _show(*lines: object) -> None:
    """Print lines as they are."""
    for line in lines:
        say(line)


@common(
    *("robot", "mapper", "lidar", "seconds", "drives", "output", "repeats", "unseen", "seed", "limits"),
    *("parameters", "reference", "relations"),
)
def tune(
    where: TuneFolder, run: Annotated[dict[str, Any], RunConfig], tuning: TuneOptions, build: World
) -> None:
    """Search for parameters of a mapper that suit a world or log; print ROS names.

    The result is compared with the defaults on unseen seeds. The same command resumes.

    Examples:
    lirs-wct tune medium --robot husky --mapper slam_toolbox_original --seconds 40 -o tune/
    lirs-wct tune robot.clf.gz --mapper hector_original --reference truth.tum --unseen 4 -o tune/
    """
    from lirs_extensions.search import case_search, tuning as search

    output, target = where.output, _tune_target(where.source, run, tuning, build)
    limits = None if tuning.limits is None else Path(tuning.limits)
    space = search.search_space(target.mapper, target.parameters, limits)
    if tuning.search == "cma":
        case_search.require_cma()
    with case_search.process_pool(tuning.jobs) as pool:
        drives = search.TuneDrives(target, tuning, space, output, pool)
        tuned = search.tune(drives, note)
        found = search.compare(drives, tuned)
    paths = search.write_results(output, drives, tuned, found)
    table = search.parameters_table(drives, tuned).as_markdown().splitlines()
    _show(search.conclusion(drives, tuned, found), *table, *paths, f"again: {search.again(drives, tuned)}")


def _tune_target(
    source: str, run: dict[str, Any], tuning: TuneOptions, build: BuildOptions
) -> RunConfig | MapConfig:
    """Return the run or the mapping whose mapper is tuned."""
    from lirs_validation.sweep.tasks import RunTask, cross
    from lirs_wct.sources.source import SourceKind, find_source

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
    RunTask(config).check()
    return config


@common(
    *("output", "lidar", "mapper", "replay", "draws", "jobs", "reference", "relations", "fov"),
    *("range_max", "scan_topic", "odom_topic", "seed"),
)
def twin(options: TwinCommand, given: Annotated[dict[str, Any], MapConfig]) -> None:
    """Compare a log with its simulation: noise.yaml for --noise, and a mapper's error.

    Examples:
    lirs-wct twin examples/data/office.clf.gz -o out/
    lirs-wct validate examples/data/office.yaml --noise out/office-TWIN/noise.yaml -o out/
    """
    from lirs_extensions.search.twin.replay import parse_mappers
    from lirs_extensions.search.twin.twin import run_twin

    config = MapConfig(log=options.log, **given)
    with progress_bar(options.log) as progress:
        result, folder = run_twin(
            config,
            lidar=options.lidar,
            seed=config.seed,
            out=options.output,
            replayed=(config.mapper,) if options.replay is None else parse_mappers(options.replay),
            draws=options.draws,
            jobs=options.jobs,
            command=command_line(),
            progress=progress,
        )
    words = ("lirs-wct", "validate", "medium", "--noise", folder / "noise.yaml", "-o", options.output)
    _show(folder / "twin.html", *result.sentences, f"next: {shlex.join(map(str, words))}")
