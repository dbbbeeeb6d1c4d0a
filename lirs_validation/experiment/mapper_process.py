"""A mapper in its own process: foreign code cannot reach the evaluation."""

from __future__ import annotations

import subprocess
import traceback
from functools import partial
from multiprocessing.connection import Connection
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, NoReturn

from lirs_validation.experiment.cost import Cost, CostMeter
from lirs_validation.experiment.mapper_loading import interpreter_of, mapper_named
from lirs_validation.experiment.mapper_under_test import Estimate, MapperUnderTest, SensorReadings
from lirs_validation.processes import ChildProcess
from lirs_wct.errors import MapperError, WctError
from slam_baselines.mapper import CLOUD_MAPPERS

if TYPE_CHECKING:
    from lirs_envs.sensing.sensors import Observation
    from lirs_validation.config import Attitude, RunConfig
    from lirs_validation.map_config import MapConfig

PATIENCE = 1.0
"""Seconds that a mapper at work is given to tidy up before its process is killed."""


def needs_process(mapper: str) -> bool:
    """Whether a mapper is foreign code: `module:name`, or an adapter of a compiled system."""
    return ":" in mapper or mapper in CLOUD_MAPPERS


def start_mapper(config: RunConfig) -> MapperUnderTest:
    """Return the mapper of a run.

    It has its own process if it is foreign code.

    Raises:
        ConfigError: the mapper cannot be made.
        MapperError: the process cannot be started.
    """
    if needs_process(config.mapper):
        return MapperProcess(config)
    make = partial(mapper_named, config.mapper, config.seed, config.parameters)
    return MapperUnderTest(make, config.mapper, config.attitude)


class MapperProcess(MapperUnderTest):
    """A mapper in another process, which ends with this object.

    Args:
        config: mapper, seed and attitude of a run or of a log's map.

    Raises:
        ConfigError: the mapper cannot be made.
        MapperError: the process cannot be started, or ended.
    """

    in_process = True

    def __init__(self, config: RunConfig | MapConfig) -> None:
        self.name = config.mapper
        third_party = config.mapper in CLOUD_MAPPERS
        self._errors = TemporaryFile() if third_party else None  # noqa: SIM115 (it outlives this method)
        outputs = {"stdout": subprocess.DEVNULL, "stderr": self._errors} if third_party else {}
        try:
            python = interpreter_of(config.mapper, config.mapper_python)
            self._child = ChildProcess(f"{__name__}:serve_mapper", PATIENCE, python, **outputs)
        except OSError as error:
            raise MapperError(f"mapper {config.mapper!r}: its process cannot be started ({error})") from error
        try:
            self._request("make", config.mapper, config.seed, config.parameters, config.attitude)
            self.reads_clouds = self._request("reads_clouds")
            self.requires_odometry = self._request("requires_odometry")
            self.reads_inertial = self._request("reads_inertial")
        except BaseException:
            self.close()  # a traceback may keep this object for long
            raise

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Give the mapper an observation; wait for its estimate (see `MapperUnderTest`)."""
        o = observation
        scan, cloud = (None, o.cloud) if self.reads_clouds else (o.scan, None)
        inertial = o.inertial if self.reads_inertial else None
        estimate: Estimate = self._request(
            "observe", SensorReadings(scan, o.odometry, o.imu, cloud, inertial)
        )
        return estimate

    def restart(self) -> None:
        """Make a new mapper; its cost counts from now on."""
        self._request("restart")

    def cost(self) -> Cost:
        """Return the cost of the process since `restart`."""
        cost: Cost = self._request("cost")
        return cost

    def close(self) -> None:
        """End the process; a mapper that is at work is interrupted."""
        self._child.end()

    def _ask(self, part: str) -> Any:
        return self._request(part)

    def _request(self, part: str, *arguments: Any) -> Any:
        try:
            self._child.pipe.send((part, *arguments))
            value, error = self._child.pipe.recv()
        except (EOFError, OSError):
            self._raise_end()
        if error is not None:
            raise error
        return value

    def _raise_end(self) -> NoReturn:
        """Raise the error of a process that has ended."""
        how = self._child.cause_of_death()
        memory = "; the system may have lacked memory" if how.endswith("SIGKILL") else ""
        raise MapperError(f"mapper {self.name!r}: its process ended ({how}{memory}){self._last_words()}")

    def _last_words(self) -> str:
        """Return the last line that a third-party system wrote to its standard error."""
        if self._errors is None:
            return ""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").split("\n")
        written = [line.strip() for line in lines if line.strip()]
        return f": {written[-1]}" if written else ""


class _ServedMapper(MapperUnderTest):
    """A mapper that measures the cost of its process."""

    def __init__(self, name: str, seed: int, parameters: str, attitude: Attitude) -> None:
        self._meter = CostMeter()
        super().__init__(partial(mapper_named, name, seed, parameters), name, attitude)

    def restart(self) -> None:
        """Make a new mapper; its cost counts from now on."""
        super().restart()
        self._meter = CostMeter()

    def cost(self) -> Cost:
        """Return the cost of this process."""
        return self._meter.cost()


def serve_mapper(pipe: Connection) -> None:
    """Make the mapper of the first message; return the parts that further messages name."""
    mapper: _ServedMapper | None = None
    while True:
        part, *arguments = pipe.recv()
        value, failure = None, None
        try:
            if mapper is None:
                mapper = _ServedMapper(*arguments)
            else:
                member = getattr(mapper, part)
                value = member(*arguments) if callable(member) else member
        except Exception as error:
            failure = _sendable(error)
        pipe.send((value, failure))


def _sendable(error: Exception) -> Exception:
    """Return a serializable error, with a note of its origin."""
    note = f"In the mapper's process:\n{''.join(traceback.format_exception(error))}"
    if type(error).__module__ != WctError.__module__:
        error = MapperError(str(error))
    error.add_note(note)
    return error
