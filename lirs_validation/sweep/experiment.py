"""Experiments of a sweep, their outcomes and manifest; a `SlamExperiment` is one validation run."""

from __future__ import annotations

import json
import traceback
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field, fields
from functools import cache, cached_property
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, ClassVar, get_args

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_validation.config import FRONTIER, TOUR, RunConfig, run_name
from lirs_validation.driving.choice import check_driver, driver_files
from lirs_validation.experiment.loading import interpreter_of, own_source_file, package_versions
from lirs_validation.experiment.mapper_under_test import check_sensors, start_mapper
from lirs_validation.experiment.run import run
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.processes import is_interrupt
from lirs_validation.record.provenance import (
    damaged_files,
    is_stale,
    machine,
    same_source,
    versions,
    world_files,
)
from lirs_validation.record.run_record import RECORD, SUCCEEDED, RunRecord, Status, plain, schema_error
from lirs_wct.contact import ContactGeometry
from lirs_wct.errors import MapperError, OutputError, SourceError, WctError, reason_of
from lirs_wct.files import atomic_folder, write_json
from lirs_wct.progress import Progress
from lirs_wct.sources.source import SourceKind, find_source

if TYPE_CHECKING:
    from lirs_validation.collision.validation import CollisionVerdict

MANIFEST = "sweep.json"
MANIFEST_SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of an experiment; small enough to keep thousands of them.

    Attributes:
        experiment: name of the experiment.
        status: status of its record.
        reason: one line.
        trace: traceback of the failure; empty without a failure.
        bad_input: whether the user's input cannot be used.
        written: whether its folder is written.
        unwritable: whether its results could not be written; it is run again.
    """

    experiment: str
    status: Status
    reason: str = ""
    trace: str = ""
    bad_input: bool = False
    written: bool = False
    unwritable: bool = False

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return self.status in SUCCEEDED


def outcome_of(error: BaseException, experiment: str) -> Outcome:
    """Return the outcome of an experiment that raised.

    Raises:
        KeyboardInterrupt: the error is a Ctrl-C that a compiled kernel wrapped.
    """
    if is_interrupt(error):
        raise KeyboardInterrupt from error
    ours = isinstance(error, WctError)
    message = str(error) if ours else ": ".join(filter(None, (type(error).__name__, str(error))))
    return Outcome(
        experiment=experiment,
        status="error",
        reason=" ".join(message.split()),
        trace="".join(traceback.format_exception(error)),
        bad_input=ours and not isinstance(error, (MapperError, OutputError)),
        unwritable=isinstance(error, OutputError),
    )


class Experiment(ABC):
    """Unit of a sweep. Every repetition on any machine gives the same folder.

    Attributes:
        marker: file with `status`, `reason` and `versions`; a folder without it is incomplete.
    """

    marker: ClassVar[str]

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of its folder, different from every other experiment's."""

    @property
    def world_config(self) -> RunConfig | None:
        """Config of its world; None = the experiment makes its world itself."""
        return None

    @abstractmethod
    def check(self) -> None:
        """Check everything that can be checked before the world is built.

        Raises:
            WctError: the experiment cannot be run as it was asked for.
        """

    @abstractmethod
    def perform(
        self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
    ) -> Outcome:
        """Run the experiment and write its folder.

        Raises:
            WctError: it cannot be run, or not written.
        """

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return the experiment's entry in `sweep.json`."""

    @abstractmethod
    def inputs(self) -> list[Path | None]:
        """Return the files that decide its result, where they are known."""

    @abstractmethod
    def failure(self, outcome: Outcome) -> str:
        """Return the marker's text for a failed experiment."""

    def is_result(self, folder: Path, entry: Mapping[str, Any]) -> bool:
        """Whether a folder, whose marker holds the entry, is of this very experiment."""
        return True

    def write_failure(self, out: Path, outcome: Outcome) -> None:
        """Write the folder of a failed experiment: its marker, and `error.txt`.

        Raises:
            OutputError: the folder cannot be written.
        """
        with atomic_folder(out / self.name) as folder:
            (folder / "error.txt").write_text(outcome.trace or outcome.reason, encoding="utf-8")
            (folder / self.marker).write_text(self.failure(outcome), encoding="utf-8")

    def find_outcome(self, out: Path) -> Outcome | None:
        """Return the outcome in a whole and current folder; None = run it."""
        folder = out / self.name
        try:
            entry = read_status(folder / self.marker)
        except SourceError:
            return None
        stale = is_stale(folder / self.marker, entry.get("versions"), self.inputs())
        if stale or damaged_files(folder, self.marker) or not self.is_result(folder, entry):
            return None
        return Outcome(experiment=self.name, status=entry["status"], reason=entry["reason"], written=True)


def read_status(path: Path) -> dict[str, Any]:
    """Read a JSON file with the `status`, the `reason` and the `versions` of an experiment.

    Raises:
        SourceError: it is missing or damaged.
    """
    try:
        entry: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        legal = entry["status"] in get_args(Status) and isinstance(entry["reason"], str)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise SourceError(f"{path}: not an experiment's result, or damaged: {reason_of(error)}") from error
    if not legal:
        raise SourceError(f"{path}: damaged: status {entry['status']!r}, reason {entry['reason']!r}")
    return entry


def attempt(
    experiment: Experiment, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
) -> Outcome:
    """Perform an experiment. All exceptions, also `SystemExit`, become outcomes.

    Raises:
        KeyboardInterrupt: the user or the parent process ends this process.
    """
    try:
        return experiment.perform(out, scenarios, progress, concurrent=concurrent)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return outcome_of(error, experiment.name)


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """Content of `sweep.json`: the requested experiments.

    Attributes:
        command: the command line.
        suite: name of the suite; None = the experiments were given one by one.
        cells: name, world, config and the suite's tables of each experiment.
    """

    command: str = ""
    suite: str | None = None
    cells: tuple[dict[str, Any], ...] = ()
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    def save(self, folder: Path) -> None:
        """Write `sweep.json`.

        Raises:
            OutputError: the folder cannot be written.
        """
        write_json(folder / MANIFEST, {"schema": MANIFEST_SCHEMA} | vars(self), plain)


TEXTS = ("world", "robot", "terrain", "diverged")
"""Fields of a verdict that are text."""
STATUS = "cell.json"
"""File with the experiment's outcome and the versions of the code that wrote it."""


@dataclass(frozen=True)
class SlamExperiment(Experiment):
    """One validation run of a sweep.

    Attributes:
        config: configuration of the run.
        tables: tables of the suite that its metrics belong to; empty outside suites.
        folder: name of its folder; None = the run's unique name.
        brief: Whether to omit the replay of the physics and the overview picture.
    """

    config: RunConfig
    tables: tuple[str, ...] = ()
    folder: str | None = None
    brief: bool = False
    marker: ClassVar[str] = RECORD

    @cached_property
    def world(self) -> str:
        """The world's name, known before the world is built."""
        return world_name(self.config)

    @cached_property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder or run_name(self.config, self.world)

    @property
    def _packages(self) -> dict[str, str]:
        return package_versions(self.config.mapper, self.config.mapper_python)

    @property
    def world_config(self) -> RunConfig:
        """The config itself."""
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
        check_driver(self.config)
        world_name(self.config)

    def perform(
        self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
    ) -> Outcome:
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
        return Outcome(experiment=self.name, status=record.status, reason=record.reason, written=True)

    def failure(self, outcome: Outcome) -> str:
        """Return a record without metrics."""
        record = RunRecord(
            config=self.config,
            world={"name": self.world},
            status=outcome.status,
            reason=outcome.reason,
            versions=versions() | self._packages,
        )
        return record.to_json()

    def inputs(self) -> list[Path | None]:
        """Return the files of world, mapper and driver."""
        return [*world_files(self.config), own_source_file(self.config.mapper), *driver_files(self.config)]

    def is_result(self, folder: Path, entry: Mapping[str, Any]) -> bool:
        """Whether config, source, bag, packages and wall limit are those of the record."""
        return (
            schema_error(entry) is None
            and same_source(self.config, entry["world"].get("files", ()))
            and entry["name"] == run_name(self.config, self.world)
            and _has_bag(entry, self.config)
            and self._packages.items() <= entry["versions"].items()
            and (entry["status"] != "wall limit" or entry["config"]["wall_limit"] == self.config.wall_limit)
        )

    def describe(self) -> dict[str, Any]:
        """Return name, world and config, and the parts of the suite."""
        config = asdict(self.config)
        return {"name": self.name, "world": self.world, "tables": list(self.tables)} | config


def _has_bag(record: Mapping[str, Any], config: RunConfig) -> bool:
    """Whether a run has the bag of its config; a failed run needs none."""
    if config.bag is None or record["status"] in ("error", "timeout"):
        return True
    held = record["config"]
    return bool((held.get("bag"), held.get("sensors_only")) == (config.bag, config.sensors_only))


@cache
def _check_names(config: RunConfig) -> None:
    make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    interpreter_of(config.mapper, config.mapper_python)
    with closing(start_mapper(config)) as mapper:
        check_sensors(mapper, config)


def world_name(config: RunConfig) -> str:
    """Return the name that a config's world will have.

    Raises:
        SourceError: there is no such source.
    """
    source = find_source(config.source, config.build)
    if source.kind is not SourceKind.FOLDER or config.build.name is not None:
        return source.name
    path = source.path / "world.json"
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["name"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SourceError(f"{path}: damaged: {reason_of(error)}") from error


@dataclass(frozen=True, kw_only=True)
class CollisionExperiment(Experiment):
    """The collision validation of a robot in a world.

    Attributes:
        source: the world.
        robot: name.
        terrain: contact geometry.
        seconds: simulated time of the random drive.
        seed: seed of the random drive.
    """

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

    @property
    def world_config(self) -> RunConfig:
        """Config that gives the world and the name; its mapper is called `collisions`."""
        return RunConfig(
            source=self.source,
            robot=self.robot,
            mapper="collisions",
            terrain=self.terrain,
            seconds=self.seconds,
            seed=self.seed,
        )

    def check(self) -> None:
        """Check that source and robot exist."""
        make_robot(self.robot)
        world_name(self.world_config)

    def perform(
        self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
    ) -> Outcome:
        """Check the contacts. A metric over its limit is no failure of the experiment."""
        from lirs_validation.collision.validation import check_collisions, write_verdicts

        progress("build", 0.0)
        world = scenarios.scenario(self.world_config).world
        progress("collide", 0.0)
        verdict = check_collisions(
            world, make_robot(self.robot), terrain=self.terrain, seconds=self.seconds, seed=self.seed
        )
        outcome = Outcome(experiment=self.name, status="ok", written=True)
        with atomic_folder(out / self.name) as folder:
            write_verdicts(folder, [verdict])
            (folder / STATUS).write_text(self.failure(outcome), encoding="utf-8")
        return outcome

    def inputs(self) -> list[Path | None]:
        """Return the files of the world."""
        return [*world_files(self.world_config)]

    def failure(self, outcome: Outcome) -> str:
        """Return config, outcome and versions."""
        entry = {"status": outcome.status, "reason": outcome.reason, "versions": versions()}
        return json.dumps({"config": asdict(self)} | entry, indent=1) + "\n"

    def describe(self) -> dict[str, Any]:
        """Return name and config."""
        return {"name": self.name, "world": world_name(self.world_config), "tables": ["collisions"]} | asdict(
            self
        )


def read_verdict(folder: Path) -> CollisionVerdict:
    """Read the verdict that an experiment wrote.

    Raises:
        SourceError: it is missing or damaged.
    """
    from lirs_validation.collision.validation import CollisionVerdict

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
