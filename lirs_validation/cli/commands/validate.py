"""The commands `validate` and `record`: robots driven through worlds with SLAM running."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lirs_validation.cli.progress import GATE_FAILED, manifest_of_command, out, run_sweep
from lirs_validation.cli.typer_options import SOURCE_HELP, complete_source
from lirs_validation.config import RUN_AXES, STAND, EngineOptions, RunConfig, SourceOptions, run_name
from lirs_validation.metrics.verdict import LIMITS, VerdictLimits
from lirs_wct.errors import ConfigError, OutputError, SourceError

if TYPE_CHECKING:
    from lirs_validation.record.verdict import Verdict
    from lirs_validation.sweep.experiment import Experiment, SlamExperiment
    from lirs_validation.sweep.sweep import Sweep

FEW = 10
"""Folders that are listed one by one."""
OF_A_SUITE = ("seed",)
"""Axes that a suite leaves open."""

Sources = Annotated[list[str] | None, typer.Argument(help=SOURCE_HELP, autocompletion=complete_source)]
SuiteName = Annotated[
    str | None,
    typer.Option(
        "--suite",
        metavar="paper|FILE.yaml",
        help="A published experiment, or a file with cases, instead of sources and axes.",
    ),
]


Gate = Annotated[bool, typer.Option("--gate", help="Exit with code 4 unless every verdict is `works`.")]
LimitsFile = Annotated[
    Path | None,
    typer.Option("--limits", metavar="FILE", help="YAML file with limits of the verdicts for --gate."),
]


def validate(
    sources: Sources = None,
    suite: SuiteName = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the runs' folders.")] = Path(
        "out"
    ),
    gate: Gate = False,
    limits: LimitsFile = None,
    *,
    run: Annotated[dict[str, Any], RunConfig],
    engine: EngineOptions,
    options: SourceOptions,
) -> None:
    """Drive robots through worlds with SLAM running, and evaluate map, trajectory and speed.

    The same command resumes an interrupted sweep. The last line is the verdict.
    """
    from lirs_validation.record.verdict import read_limits

    if limits is not None and not gate:
        raise ConfigError("--limits is for --gate, which is not given")
    accepted = read_limits(limits) if limits is not None else (LIMITS, frozenset[str]())
    found = _run(read_experiments(sources, suite, run, options), engine, output, suite, limits=accepted[0])
    if gate and not all(verdict.kind in {"works", *accepted[1]} for verdict in found):
        raise typer.Exit(GATE_FAILED)


def record(
    sources: Sources = None,
    suite: SuiteName = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder of the bag; of several runs, for theirs.")
    ] = Path("run"),
    *,
    run: Annotated[dict[str, Any], RunConfig],
    engine: EngineOptions,
    options: SourceOptions,
) -> None:
    """Record a drive as a ROS 2 bag: validate with --bag, into the named folder.

    The folder is also that of the run: score, export and report take it. Several runs get folders in it.
    """
    from lirs_validation.sweep.experiment import SlamExperiment

    experiments = read_experiments(sources, suite, {"bag": "mcap", "stand": STAND, **run}, options)
    if len(experiments) > 1 or not isinstance(experiments[0], SlamExperiment):
        _run(experiments, engine, output, suite)
        return
    folder = output if output.name else output.resolve()
    experiment = replace(experiments[0], folder=folder.name)
    _check_free(folder, experiment)
    _run((experiment,), engine, folder.parent, suite, listed=False)


def read_experiments(
    sources: list[str] | None, suite: str | None, run: dict[str, Any], build: SourceOptions
) -> tuple[Experiment, ...]:
    """Return the experiments of a suite, or of every combination of the given options.

    Args:
        sources: worlds; none with a suite.
        suite: its name; None = sources and axes are given.
        run: options of `RunConfig` that were given, a tuple of values for each axis.
        build: how sources become worlds.

    Raises:
        ConfigError: neither or both of sources and suite are given, or an option is not legal.
    """
    from lirs_validation.sweep.experiment import SlamExperiment
    from lirs_validation.sweep.suites import SUITE_FILES, case_options, cross, make_suite, suite_folders

    if suite is not None and suite.endswith(SUITE_FILES) and not sources:
        sources, suite = list(suite_folders(Path(suite))), None
    if suite is None:
        if not sources:
            raise ConfigError("nothing to validate: name a source (simple, an image, ...) or a --suite")
        crossed = [cross(source, build=build, **(case_options(source) | run)) for source in sources]
        return tuple(SlamExperiment(config) for configs in crossed for config in configs)
    clash = [f"--{name}" for name in RUN_AXES if name in run and name not in OF_A_SUITE]
    clash += ["sources"] * bool(sources) + ["options of build"] * (build != SourceOptions())
    if clash:
        raise ConfigError(f"--suite {suite} has its own worlds and axes: leave out {', '.join(clash)}")
    return make_suite(suite, **run)


def _run(
    experiments: Sequence[Experiment],
    engine: EngineOptions,
    out: Path,
    suite: str | None,
    *,
    listed: bool = True,
    limits: VerdictLimits = LIMITS,
) -> list[Verdict]:
    """Run experiments, print their tables and verdicts; return the verdicts."""
    from lirs_validation.sweep.sweep import Sweep

    manifest = manifest_of_command(suite)
    sweep = Sweep(experiments, out, manifest=manifest, listed=listed, retry_failed=engine.retry_failed)
    verdicts: list[Verdict] = []
    run_sweep(sweep, engine, lambda: verdicts.extend(_show(sweep, limits)))
    return verdicts


def _check_free(folder: Path, experiment: SlamExperiment) -> None:
    """Refuse a folder that holds something else than this very run: it would be replaced.

    Raises:
        OutputError: it does.
    """
    from lirs_validation.record.run_record import read_record

    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    wanted = run_name(experiment.config, experiment.world)
    try:
        held = read_record(folder)["name"]
    except SourceError:
        raise OutputError(f"{folder}: holds something else than a run; choose another --output") from None
    if held != wanted:
        raise OutputError(f"{folder}: holds another run, {held}; choose another --output")


def _show(sweep: Sweep, limits: VerdictLimits) -> list[Verdict]:
    """Print tables, folders and verdicts of a sweep; return the verdicts."""
    from lirs_validation.record.run_record import read_record
    from lirs_validation.record.verdict import judge
    from lirs_validation.report.run_tables import sweep_tables, verdict_lines

    if not sweep.outcomes:
        return []
    for table in sweep_tables(sweep):
        out.print(table)
    folders = [sweep.out / found.name for found in sweep.experiments if found.name in sweep.outcomes]
    for folder in folders if len(folders) <= FEW else [sweep.out]:
        out.print(f"{folder}", soft_wrap=True, highlight=False)
    entries = [read_record(folder) for folder in folders if (folder / "record.json").exists()]
    runs = [entry for entry in entries if "mapper" in entry["config"]]
    rates = {f"{run['scans']['imu_rate']:g} Hz" for run in runs if run.get("scans", {}).get("imu_rate")}
    if rates:
        out.print(f"inertial readings: {', '.join(sorted(rates))}", highlight=False)
    for line in verdict_lines(runs, limits):
        out.print(line, soft_wrap=True, highlight=False, markup=False)
    return [judge(entry, limits) for entry in runs]
