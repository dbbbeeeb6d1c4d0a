"""Tasks of a sweep: validation runs and collision validations, suites, and engines by option."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, fields
from functools import cache, cached_property
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar

from lirs_envs.robots.robot import make_robot
from lirs_validation.collision.validation import CollisionVerdict, check_collisions, write_verdicts
from lirs_validation.config import FRONTIER, NOISE_FILES, RUN_AXES, TOUR, EngineOptions, RunConfig, run_name
from lirs_validation.driving.choice import check_driver, driver_files
from lirs_validation.experiment.loading import own_source_file
from lirs_validation.experiment.mapper_under_test import check_sensors, package_versions, start_mapper
from lirs_validation.experiment.run import run
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.run_record import (
    RECORD,
    RunRecord,
    same_source,
    schema_error,
    versions,
    world_files,
)
from lirs_validation.sweep.sweep import Executor, Outcome, Serial, SweepTask
from lirs_wct.contact import ContactGeometry
from lirs_wct.errors import SourceError, reason_of, require_known
from lirs_wct.files import atomic_folder
from lirs_wct.formats.yaml_text import load_yaml
from lirs_wct.progress import Progress
from lirs_wct.sources.source import BuildOptions, SourceKind, find_source


@dataclass(frozen=True)
class RunTask(SweepTask):
    """One validation run of a sweep.

    Attributes:
        folder: Name of its folder; None = the run's unique name.
        brief: Whether to omit the replay of the physics and the overview picture.
    """

    config: RunConfig
    folder: str | None = None
    brief: bool = False
    marker: ClassVar[str] = RECORD

    @cached_property
    def world(self) -> str:
        """Name of the world, known before the world is built."""
        return world_name(self.config)

    @cached_property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder or run_name(self.config, self.world)

    @property
    def world_config(self) -> RunConfig:
        """Config of the run."""
        return self.config

    def check(self) -> None:
        """Check source, robot, lidar, mapper, and the file of the driver."""
        c = self.config
        decisive = RunConfig(
            source="",
            robot=c.robot,
            lidar=c.lidar,
            mapper=c.mapper,
            parameters=c.parameters,
            mapper_python=c.mapper_python,
            driver=FRONTIER if c.driver == FRONTIER else TOUR,
        )
        _check_names(decisive)
        check_driver(c)
        _ = self.world

    def run(self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool) -> Outcome:
        """Run the config and write its folder."""
        record = run(
            self.config,
            out=out,
            progress=progress,
            scenarios=scenarios,
            concurrent=concurrent,
            name=self.folder,
            brief=self.brief,
        ).record
        seconds = float(record.cost["compile_seconds"])
        return Outcome(
            task=self.name, status=record.status, reason=record.reason, compile_seconds=seconds, written=True
        )

    def describe(self) -> dict[str, Any]:
        """Return name, world and config."""
        return {"name": self.name, "world": self.world} | asdict(self.config)

    def failure(self, outcome: Outcome) -> str:
        """Return a record without metrics."""
        return RunRecord(
            config=self.config,
            world={"name": self.world},
            status=outcome.status,
            reason=outcome.reason,
            versions=versions() | self._packages,
        ).to_json()

    def inputs(self) -> list[Path | None]:
        """Return the files of world, mapper and driver."""
        return [*world_files(self.config), own_source_file(self.config.mapper), *driver_files(self.config)]

    def is_result(self, folder: Path, entry: Mapping[str, Any]) -> bool:
        """Whether config, source, bag, packages and wall limit are those of the record."""
        config = self.config
        if schema_error(entry) is not None or entry["name"] != run_name(config, self.world):
            return False
        recorded, status = entry["config"], entry["status"]
        bag = (config.bag, config.sensors_only)
        same_bag = config.bag is None or (recorded.get("bag"), recorded.get("sensors_only")) == bag
        return (
            same_source(config, entry["world"].get("files", ()))
            and (same_bag or status in ("error", "timeout"))
            and self._packages.items() <= entry["versions"].items()
            and (status != "wall limit" or recorded["wall_limit"] == config.wall_limit)
        )

    @property
    def _packages(self) -> dict[str, str]:
        return package_versions(self.config.mapper, self.config.mapper_python)


@cache
def _check_names(config: RunConfig) -> None:
    with closing(start_mapper(config)) as mapper:
        check_sensors(mapper, config)


def world_name(config: RunConfig) -> str:
    """Return the name that a config's world will have."""
    source = find_source(config.source, config.build)
    if source.kind is not SourceKind.FOLDER or config.build.name is not None:
        return source.name
    path = source.path / "world.json"
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["name"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SourceError(f"{path}: damaged: {reason_of(error)}") from error


TEXTS = ("world", "robot", "terrain", "diverged")
"""Fields of a collision verdict that are text."""
STATUS = "cell.json"
"""File with the task's outcome and the versions of the code that wrote it."""


@dataclass(frozen=True, kw_only=True)
class CollisionTask(SweepTask):
    """The collision validation of a robot: a seeded random drive of some seconds."""

    source: str
    robot: str
    terrain: ContactGeometry = "hfield"
    seconds: float = 60.0
    seed: int = 1
    marker: ClassVar[str] = STATUS

    @property
    def name(self) -> str:
        """Name of its folder."""
        return run_name(self.world_config, world_name(self.world_config))

    @cached_property
    def world_config(self) -> RunConfig:
        """Config that gives the world and the name; its mapper is called `collisions`."""
        return RunConfig(mapper="collisions", **asdict(self))

    def check(self) -> None:
        """Check that source and robot exist."""
        make_robot(self.robot)
        world_name(self.world_config)

    def run(self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool) -> Outcome:
        """Check the contacts. A metric over its limit is no failure of the task."""
        robot = make_robot(self.robot)
        progress("build", 0.0)
        world = scenarios.scenario(self.world_config).world
        progress("collide", 0.0)
        verdict = check_collisions(world, robot, terrain=self.terrain, seconds=self.seconds, seed=self.seed)
        outcome = Outcome(task=self.name, status="ok", written=True)
        with atomic_folder(out / self.name) as folder:
            write_verdicts(folder, [verdict])
            (folder / STATUS).write_text(self.failure(outcome), encoding="utf-8")
        return outcome

    def describe(self) -> dict[str, Any]:
        """Return name, world and options."""
        return {"name": self.name, "world": world_name(self.world_config)} | asdict(self)

    def failure(self, outcome: Outcome) -> str:
        """Return config, outcome and versions."""
        entry = {"status": outcome.status, "reason": outcome.reason, "versions": versions()}
        return json.dumps({"config": asdict(self)} | entry, indent=1) + "\n"

    def inputs(self) -> list[Path | None]:
        """Return the files of the world."""
        return [*world_files(self.world_config)]


def read_verdict(folder: Path) -> CollisionVerdict:
    """Read the verdict that a collision validation wrote."""
    path = folder / "collisions.json"
    try:
        entry = json.loads(path.read_text(encoding="utf-8"))["collisions"][0]
        verdict = CollisionVerdict(**{f.name: entry[f.name] for f in fields(CollisionVerdict)})
    except (OSError, ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        raise SourceError(f"{path}: not a collision check, or damaged: {reason_of(error)}") from error
    for name, value in vars(verdict).items():
        if not isinstance(value, (str, int, float, NoneType)) or isinstance(value, str) != (name in TEXTS):
            raise SourceError(f"{path}: damaged: {name} is {value!r}")
    return verdict


def cross(
    sources: str | tuple[str, ...],
    *,
    build: BuildOptions | None = None,
    kind: type[RunConfig] = RunConfig,
    **options: Any,
) -> tuple[RunConfig, ...]:
    """Return the config of every combination, source by source, in the order of RunConfig's fields.

    A tuple among the options, which are fields of RunConfig, holds the values to cross.

    >>> [(c.mapper, c.seed) for c in cross("simple", mapper=("hector", "gmapping"), seed=(1, 2))]
    [('hector', 1), ('hector', 2), ('gmapping', 1), ('gmapping', 2)]
    """
    names = sorted(options, key=[f.name for f in fields(kind)].index)
    values = [options[name] if isinstance(options[name], tuple) else (options[name],) for name in names]
    worlds = (sources,) if isinstance(sources, str) else sources
    shared: dict[str, Any] = {} if build is None else {"build": build}
    return tuple(
        kind(source=source, **dict(zip(names, crossing, strict=True)), **shared)
        for source, *crossing in itertools.product(worlds, *values)
    )


HEIGHTMAP, SOLID, OURS = "heightmap-based", "solid-based", "ours"
VIEWS = {HEIGHTMAP: ("hfield", "mujoco"), SOLID: ("mesh", "mujoco"), OURS: ("hfield", "builtin")}
"""Contact geometry and ray caster of each terrain representation. The first two are the paper's."""
WORLDS = {"simple": "II", "medium": "III", "advanced": "IV"}
"""Worlds, and the paper's tables that hold their RTF."""
MAPPERS = {"gmapping": "GMapping", "hector": "HectorSLAM", "cartographer": "Cartographer"}
HUSKY = "husky"
"""Robot of the paper's Tables II to IV."""
ROBOTS = (HUSKY, "turtlebot2", "jackal")
SUITES: dict[str, dict[str, Any]] = {
    "paper": {"wall_limit": 120.0},
    "paper-short": {"seconds": 20.0, "wall_limit": 10.0},
}
"""Options of the paper's experiment in full and in ten minutes.

At the wall limit, seconds, a hopelessly slow drive is stopped, and its real-time factor extrapolated.
"""


def make_suite(name: str, **options: Any) -> tuple[SweepTask, ...]:
    """Return the tasks of the paper's Sections V and III-D, world by world.

    The options are those of every run, in place of the suite's own (`seconds`, `seed`, `wall_limit`).
    """
    require_known("suite", name, SUITES)
    tasks: list[SweepTask] = []
    for world in WORLDS:
        for mapper, view in itertools.product(MAPPERS, (OURS, SOLID, HEIGHTMAP)):
            terrain, rays = VIEWS[view]
            axes = {"robot": HUSKY if view == HEIGHTMAP else ROBOTS, "terrain": terrain, "rays": rays}
            tasks += map(RunTask, cross(world, mapper=mapper, **SUITES[name] | axes | options))
        tasks += (CollisionTask(source=world, robot=robot) for robot in ROBOTS)
    return tuple(tasks)


def make_executor(options: EngineOptions, scenarios: ScenarioCache | None = None) -> Executor:
    """Make a Ray cluster, processes for jobs or a time limit, or `Serial` with worlds built before."""
    if options.address is None and options.jobs in (None, 1) and options.cell_timeout is None:
        return Serial(scenarios)
    from lirs_validation.sweep.engines import Processes, RayCluster

    if options.address is not None:
        return RayCluster(address=options.address, jobs=options.jobs, seconds=options.cell_timeout)
    return Processes(jobs=options.jobs or 1, seconds=options.cell_timeout)


CASE = "case.yaml"
"""File with the options of a run, in the folder of its world."""
SUITE_FILES = (".yaml", ".yml")
CASE_OPTIONS = (*RUN_AXES, "seconds", "stand")


def case_options(source: str | Path) -> dict[str, Any]:
    """Return the options of a case's run; empty if the source is no case."""
    path = Path(source) / CASE
    if not path.is_file():
        return {}
    options = read_yaml_fields(path).get("run")
    if not isinstance(options, dict) or not set(options) <= set(CASE_OPTIONS):
        raise SourceError(
            f"{path}: `run` must hold options of a run ({', '.join(CASE_OPTIONS)}), got {options!r}"
        )
    if str(options.get("noise", "")).endswith(NOISE_FILES):
        options["noise"] = str(path.parent / options["noise"])
    return options


def suite_folders(path: Path) -> tuple[str, ...]:
    """Return the folders of a suite: the list `cases` of a YAML file."""
    names = read_yaml_fields(path).get("cases")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise SourceError(f"{path}: `cases` must be a list of folders, got {names!r}")
    for name in names:
        if not (path.parent / name / CASE).is_file():
            raise SourceError(f"{path}: {name} is no case: it has no {CASE}")
    return tuple(str(path.parent / name) for name in names)


def read_yaml_fields(path: Path) -> Mapping[str, Any]:
    """Return the names and values of a YAML file."""
    try:
        entry = load_yaml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SourceError(f"{path}: {reason_of(error)}") from error
    if not isinstance(entry, dict) or not entry:
        raise SourceError(f"{path}: must hold names and values, got {entry!r:.40}")
    return entry
