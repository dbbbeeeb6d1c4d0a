"""An experiment that drives, maps and evaluates: one validation run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.catalog import make_robot
from lirs_validation.config import TOUR, RunConfig, driver_parts, run_name
from lirs_validation.driving.choice import check_driver, driver_files
from lirs_validation.experiment.mapper_loading import package_versions, source_file
from lirs_validation.experiment.mapper_process import start_mapper
from lirs_validation.experiment.mapper_under_test import check_sensors
from lirs_validation.experiment.run import run
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.provenance import is_stale, same_source, versions, world_files
from lirs_validation.record.run_record import RunRecord, damaged_files, file_sizes
from lirs_validation.record.schema import read_whole_record
from lirs_validation.sweep.experiment import Outcome
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import atomic_folder
from lirs_wct.progress import Progress
from lirs_wct.sources.options import SourceKind
from lirs_wct.sources.source import find_source


@dataclass(frozen=True)
class SlamExperiment:
    """One validation run of a sweep.

    Attributes:
        config: configuration of the run.
        tables: tables of the suite that its metrics belong to; empty outside suites.
        folder: name of its folder; None = the run's unique name.
    """

    config: RunConfig
    tables: tuple[str, ...] = ()
    folder: str | None = None

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
        frontier = driver_parts(c.driver)[0] == "frontier"
        _check_names(c.robot, c.lidar, c.mapper, c.parameters, c.mapper_python, frontier)
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
        ).record
        return Outcome(experiment=self.name, status=record.status, reason=record.reason, written=True)

    def write_failure(self, out: Path, outcome: Outcome) -> None:
        """Write a record without metrics, and the traceback."""
        record = RunRecord(
            config=self.config,
            world={"name": self.world},
            status=outcome.status,
            reason=outcome.reason,
            versions=versions() | self._packages,
        )
        with atomic_folder(out / self.name) as folder:
            (folder / "error.txt").write_text(outcome.trace or outcome.reason, encoding="utf-8")
            replace(record, file_sizes=file_sizes(folder)).save(folder)

    def find_outcome(self, out: Path) -> Outcome | None:
        """Return the recorded outcome if the folder is complete and newer than all inputs."""
        folder = out / self.name
        try:
            record = read_whole_record(folder)
        except SourceError:
            return None
        status, reason, limit = record["status"], record["reason"], record["config"]["wall_limit"]
        if damaged_files(folder, record) or not same_source(self.config, record["world"].get("files", ())):
            return None
        inputs = [*world_files(self.config), source_file(self.config.mapper), *driver_files(self.config)]
        if is_stale(folder / "record.json", record.get("versions"), inputs):
            return None
        if record["name"] != run_name(self.config, self.world) or not _has_bag(record, self.config):
            return None
        if (
            not package_versions(self.config.mapper, self.config.mapper_python).items()
            <= record["versions"].items()
        ):
            return None
        if status == "wall limit" and limit != self.config.wall_limit:
            return None
        return Outcome(experiment=self.name, status=status, reason=reason, written=True)

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
def _check_names(
    robot: str, lidar: str | None, mapper: str, parameters: str, mapper_python: str | None, frontier: bool
) -> None:
    make_lidar_preset(lidar or make_robot(robot).lidar)
    driver = "frontier" if frontier else TOUR
    asked = RunConfig(
        source="",
        robot=robot,
        lidar=lidar,
        mapper=mapper,
        parameters=parameters,
        mapper_python=mapper_python,
        driver=driver,
    )
    with closing(start_mapper(asked)) as made:
        check_sensors(made, asked)


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
