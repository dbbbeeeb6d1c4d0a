"""`lirs-wct verdict`, `falsify` and `tune`: decide, search failures, search parameters."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lirs_validation.cli.progress import GATE_FAILED, err, out
from lirs_validation.cli.typer_options import Sources
from lirs_validation.config import EngineOptions, RunConfig, SourceOptions
from lirs_validation.falsify import FalsifyOptions
from lirs_validation.map_config import MapConfig
from lirs_validation.tune import TuneOptions
from lirs_wct import BuildOptions, ConfigError

if TYPE_CHECKING:
    from lirs_validation.decision.trials import Perform, Trial
    from lirs_validation.sweep.experiment import Outcome
    from lirs_validation.sweep.sweep import Sweep

Budget = Annotated[
    str,
    typer.Option(
        "--budget",
        metavar="TIME",
        help="Wall time after which no drive begins: 90s, 10min, 2h; 0s = forecast alone.",
    ),
]
Output = Annotated[Path, typer.Option("-o", "--output", help="Folder for page and drives.")]
UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def read_duration(text: str, flag: str) -> float:
    """Return the seconds of a duration such as `90s`, `10min` or `2h`.

    Raises:
        ConfigError: the text is none.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|min|h)\s*", text)
    if match is None:
        raise ConfigError(f"{flag} must be a duration such as 90s, 10min or 2h, got {text!r}")
    return float(match[1]) * UNITS[match[2]]


def verdict(
    sources: Sources,
    budget: Budget = "10min",
    output: Output = Path("verdict"),
    gate: Annotated[bool, typer.Option("--gate", help="Exit with code 4 unless every method works.")] = False,
    *,
    run: Annotated[dict[str, Any], RunConfig],
    engine: EngineOptions,
    options: SourceOptions,
) -> None:
    """Decide whether SLAM methods work on a terrain: drive until a sequential test decides.

    Seeds count up from --seed; each has another start, tour and sensor noise. The same command continues.
    """
    from lirs_validation.decision.decide import decide
    from lirs_validation.decision.page import changes_table, methods_table, write_decision
    from lirs_validation.sweep.suites import cross

    seconds = read_duration(budget, "--budget")
    if len(run.get("seed", ())) > 1:
        raise ConfigError(f"--seed is the first seed of the drives: one number, got {len(run['seed'])}")
    configs = cross(tuple(sources), build=options, **run)
    answers = decide(
        configs,
        output,
        _performer(engine),
        budget=seconds,
        report=_print_state,
        retry_failed=engine.retry_failed,
    )
    page = write_decision(output, answers, shlex.join(["lirs-wct", *sys.argv[1:]]))
    out.print(methods_table(answers))
    if any(answer.changed for answer in answers):
        out.print(changes_table(answers))
    out.print(f"{page}", soft_wrap=True, highlight=False)
    for answer in answers:
        out.print(f"verdict: {answer.sentence}", soft_wrap=True, highlight=False, markup=False)
    if gate and any(answer.trial.decision != "works" for answer in answers):
        raise typer.Exit(GATE_FAILED)


def _performer(engine: EngineOptions) -> Perform:
    """Return the function that runs a sweep with the engine, under a bar of progress."""
    from lirs_validation.cli.progress import run_with_progress
    from lirs_validation.sweep.sweep import make_executor

    executor = make_executor(engine)

    def perform(sweep: Sweep) -> Generator[Outcome]:
        yield from run_with_progress(sweep, executor, err)

    return perform


def _print_state(trial: Trial) -> None:
    """Print the forecast of a trial, or the verdict of its last drive and what it means for the decision."""
    from lirs_validation.decision.decide import forecast_text

    if not trial.drives:
        err.print(forecast_text(trial), soft_wrap=True, highlight=False, markup=False)
        return
    drive, test = trial.drives[-1], trial.test
    decided = "" if trial.decision == "undecided" else f": {trial.decision}"
    counts = f"{test.successes} of {test.successes + test.failures} worked{decided}"
    err.print(f"{drive.folder}: {drive.kind}; {counts}", soft_wrap=True, highlight=False, markup=False)


Failures = Annotated[Path, typer.Option("-o", "--output", help="Folder for cases, page and archive.")]


def falsify(output: Failures = Path("falsify"), *, options: FalsifyOptions) -> None:
    """Search for the easiest terrain, drive and sensor degradation on which a method fails.

    Each case fails with at least 4 of 5 new seeds and is reduced to its cause. The same command resumes.
    """
    from lirs_validation.falsify import search
    from lirs_validation.falsify.drives import CaseDrives, check_methods, search_limits
    from lirs_validation.falsify.results import conclusion, write_results
    from lirs_validation.search import process_pool, require_cma

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


Tuned = Annotated[Path, typer.Option("-o", "--output", help="Folder for tuned values, table and archive.")]
TuneSource = Annotated[str, typer.Argument(metavar="SOURCE", help="World, picture, map or laser log.")]


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
    from lirs_validation.search import process_pool, require_cma
    from lirs_validation.tune import search

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
