"""The commands `validate`, `record` and `collide`: robots driven through worlds."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from click.exceptions import Exit

from lirs_validation.cli.command import BagOptions, LimitsOption, common, map_logs, sources_argument
from lirs_validation.cli.exit_codes import ExitCode
from lirs_validation.cli.progress import command_line, note, out, progress_bar, run_sweep, say
from lirs_validation.config import DRIVABLE, RUN_AXES, STAND, EngineOptions, RunConfig, World, run_name
from lirs_validation.record.run_record import read_record
from lirs_validation.record.verdict import LIMITS, VerdictLimits, read_limits, stored_verdict
from lirs_wct import BuildOptions, ConfigError, OutputError, SourceError, WctError
from lirs_wct.contact import ContactGeometry
from lirs_wct.option import Options, option

if TYPE_CHECKING:
    from lirs_validation.collision.validation import CollisionVerdict
    from lirs_validation.sweep.sweep import Sweep, SweepTask
    from lirs_validation.sweep.tasks import RunTask

MAX_LISTED = 10
"""Folders that are listed one by one."""
OF_A_SUITE = ("seed",)
"""Axes that a suite leaves open."""


@dataclass(frozen=True, kw_only=True)
class SweepOptions(Options):
    """Sources and suite of a sweep."""

    sources: tuple[str, ...] = sources_argument(default=())
    suite: str | None = option(
        None,
        "The paper's experiment, in full or in 10 minutes, or a file of cases; has its sources and axes.",
        metavar="paper|paper-short|FILE.yaml",
    )


@dataclass(frozen=True, kw_only=True)
class ValidateOptions(SweepOptions, LimitsOption):
    """Sources, results and gate of `validate`."""

    output: Path = option(Path("out"), "Folder for the runs' folders.")
    gate: bool = option(False, "Exit with code 4 unless every verdict is `works`.")
    baseline: Path | None = option(
        None, "Stored runs: --gate fails instead where a run is significantly worse.", metavar="FOLDER"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("limits", "baseline"):
            if getattr(self, name) is not None and not self.gate:
                raise ConfigError(f"--{name} is for --gate, which is not given")
        if self.baseline is not None and self.baseline.resolve() == self.output.resolve():
            raise ConfigError(f"{self.baseline}: the baseline must be another folder than --output")


@dataclass(frozen=True, kw_only=True)
class RecordOptions(BagOptions, SweepOptions):
    """Sources and bag of `record`."""

    output: Path = option(Path("run"), "Folder of the bag; of several runs, for theirs.")


@dataclass(frozen=True, kw_only=True)
class CollideOptions(Options):
    """Worlds, robots and drives of `collide`."""

    sources: tuple[str, ...] = sources_argument()
    robot: tuple[str, ...] = option(("husky", "jackal", "turtlebot2"), "Robots.", metavar="R,R,...")
    terrain: tuple[ContactGeometry, ...] = option(
        ("hfield",), "Contact geometry: hfield, mesh, prisms, convex.", metavar="T,T,..."
    )
    seconds: float = option(60.0, "Simulated seconds to drive each.", check=DRIVABLE)
    seed: tuple[int, ...] = option((1,), "Seeds of the random drives.", metavar="N,N-M")
    output: Path = option(Path("out"), "Folder for collisions.json and collisions.csv.")


_DRIVE = ("robot", "mapper", "lidar", "seconds", "seed", "output", "driver", "attitude")


@common(*_DRIVE, "size", "height", "jobs", "gate", "suite")
def validate(
    options: ValidateOptions, run: Annotated[dict[str, Any], RunConfig], engine: EngineOptions, build: World
) -> None:
    """Drive robots through worlds with SLAM running, and evaluate map, trajectory and speed.

    The same command resumes an interrupted sweep. The last line is the verdict, or the gate's.

    Examples:
    lirs-wct validate examples/data/dunes.png --mapper hector --seconds 60 --seed 1 -o out/
    lirs-wct validate simple medium --robot husky,jackal --mapper hector,gmapping --seed 1-5 -o out/
    lirs-wct validate medium --lidar vlp16 --mapper kiss-icp,genz-icp,hector --seed 1-3 -o out/
    """
    from lirs_validation.analysis.results import read_baseline
    from lirs_validation.report.run_tables import baseline_lines

    limits, accepted = read_limits(options.limits)
    tasks = read_tasks(options, run, build)
    cells = [cell for task in tasks if "mapper" in (cell := task.describe())]
    stored = [] if options.baseline is None else read_baseline(options.baseline, cells)
    runs = _run(tasks, engine, options.output, options.suite, limits=limits)
    passed = all(stored_verdict(entry, limits).kind in {"works", *accepted} for entry in runs)
    if stored:
        worse, notes = baseline_lines(stored, runs, limits, accepted)
        passed = not worse
        for line in (*worse, *notes):
            say(f"gate: {line}")
    if options.gate and not passed:
        raise Exit(ExitCode.GATE_FAILED)


@common(*_DRIVE, "actors", "size", "height", "storage", "sensors_only")
def record(
    options: RecordOptions, run: Annotated[dict[str, Any], RunConfig], engine: EngineOptions, build: World
) -> None:
    """Record a drive as a ROS 2 bag, in the folder of its run.

    Score, export and report take the folder. Several runs get folders in it.

    Examples:
    lirs-wct record simple --seconds 60 -o run
    """
    bag = {"bag": options.storage, "sensors_only": options.sensors_only, "stand": STAND}
    tasks, output = read_tasks(options, bag | run, build), options.output
    if len(tasks) > 1:
        _run(tasks, engine, output, options.suite)
        return
    folder = output if output.name else output.resolve()
    task = replace(cast("RunTask", tasks[0]), folder=folder.name)
    _check_free(folder, task)
    _run((task,), engine, folder.parent, options.suite, listed=False)


def read_tasks(
    options: ValidateOptions | RecordOptions, run: dict[str, Any], build: BuildOptions
) -> tuple[SweepTask, ...]:
    """Return the tasks of a suite, or of every combination of the given options.

    `run` holds given options of `RunConfig`, a tuple of values for each axis.
    """
    from lirs_validation.sweep.tasks import (
        SUITE_FILES,
        RunTask,
        case_options,
        cross,
        make_suite,
        suite_folders,
    )

    sources, suite = options.sources, options.suite
    if suite is not None and suite.endswith(SUITE_FILES) and not sources:
        sources, suite = suite_folders(Path(suite)), None
    if suite is None:
        if not sources:
            raise ConfigError("nothing to validate: name a source (simple, an image, ...) or a --suite")
        sources, build = map_logs(sources, build, options.output)
        crossed = [cross(source, build=build, **(case_options(source) | run)) for source in sources]
        return tuple(RunTask(config) for configs in crossed for config in configs)
    clash = [f"--{name}" for name in RUN_AXES if name in run and name not in OF_A_SUITE]
    clash += ["sources"] * bool(sources) + ["options of build"] * (build != BuildOptions())
    if clash:
        raise ConfigError(f"--suite {suite} has its own worlds and axes: leave out {', '.join(clash)}")
    return make_suite(suite, **run)


def _run(
    tasks: Sequence[SweepTask],
    engine: EngineOptions,
    out: Path,
    suite: str | None,
    *,
    listed: bool = True,
    limits: VerdictLimits = LIMITS,
) -> list[dict[str, Any]]:
    """Run tasks, print their tables and verdicts; return the records of the runs."""
    from lirs_validation.sweep.sweep import Sweep

    options: dict[str, Any] = {"command": command_line(), "suite": suite, "listed": listed}
    sweep = Sweep(tasks, out, **options, retry_failed=engine.retry_failed)
    runs: list[dict[str, Any]] = []
    run_sweep(sweep, engine, lambda: runs.extend(_show(sweep, limits)))
    return runs


def _check_free(folder: Path, task: RunTask) -> None:
    """Refuse a folder that holds something else than this very run: it would be replaced."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    wanted = run_name(task.config, task.world)
    try:
        held = read_record(folder)["name"]
    except SourceError:
        raise OutputError(f"{folder}: holds something else than a run; choose another --output") from None
    if held != wanted:
        raise OutputError(f"{folder}: holds another run, {held}; choose another --output")


def _show(sweep: Sweep, limits: VerdictLimits) -> list[dict[str, Any]]:
    """Print tables, folders and verdicts of a sweep; return the records of its runs."""
    from lirs_validation.report.run_tables import sweep_tables, verdict_lines

    if not sweep.outcomes:
        return []
    for table in sweep_tables(sweep):
        out.print(table)
    folders = [sweep.out / found.name for found in sweep.tasks if found.name in sweep.outcomes]
    for folder in folders if len(folders) <= MAX_LISTED else [sweep.out]:
        say(folder)
    if len(folders) > 1:
        note(f"tables and pictures: lirs-wct report {shlex.quote(str(sweep.out))}")
    entries = [read_record(folder) for folder in folders if (folder / "record.json").exists()]
    runs = [entry for entry in entries if "mapper" in entry["config"]]
    rates = {f"{run['scans']['imu_rate']:g} Hz" for run in runs if run.get("scans", {}).get("imu_rate")}
    if rates:
        say(f"inertial readings: {', '.join(sorted(rates))}")
    for line in verdict_lines(runs, limits):
        say(line)
    return runs


def collide(options: CollideOptions, build: World) -> None:
    """Drive robots at random into obstacles and evaluate contacts: penetration, energy, slopes.

    Examples:
    lirs-wct collide simple advanced --robot husky,turtlebot2 --seconds 60 -o out/
    """
    from lirs_validation.collision.validation import write_verdicts
    from lirs_validation.report.run_tables import verdicts_table

    sources, build = map_logs(options.sources, build, options.output)
    verdicts: list[CollisionVerdict] = []
    refused: list[WctError] = []
    try:
        for found in _check_collisions(options, sources, build):
            if isinstance(found, WctError):
                refused.append(found)
            else:
                verdicts.append(found)
    finally:
        if verdicts:
            out.print(verdicts_table(verdicts))
            for path in write_verdicts(options.output, verdicts):
                say(path)
    if not verdicts:
        raise refused[0]
    for error in refused:
        note(f"left out: {error}", style="yellow")
    if refused or not all(verdict.passed for verdict in verdicts):
        raise Exit(ExitCode.RUN_FAILED)


def _check_collisions(
    options: CollideOptions, sources: tuple[str, ...], build: BuildOptions
) -> Iterator[CollisionVerdict | WctError]:
    """Yield the verdict on each robot, terrain and seed in each world."""
    from lirs_envs.robots.robot import make_robot
    from lirs_validation.collision.validation import check_collisions
    from lirs_validation.experiment.scenario import build_scenario

    robots = [make_robot(name) for name in options.robot]
    checks = list(itertools.product(robots, options.terrain, options.seed))
    steps = len(sources) * len(checks)
    done = 0
    with progress_bar("collide") as progress:
        for source in sources:
            progress(f"building {source}", done / steps)
            config = RunConfig(source=source, seconds=options.seconds, build=build)
            try:
                world = build_scenario(config).world
            except WctError as error:
                yield error
                done += len(checks)
                continue
            for who, where, seed in checks:
                progress(f"{source}, {who.name} on {where}", done / steps)
                try:
                    yield check_collisions(world, who, terrain=where, seconds=options.seconds, seed=seed)
                except WctError as error:
                    yield error
                done += 1
