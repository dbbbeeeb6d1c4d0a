"""Mapper of a run or a log.

Ours works in this process, foreign code in a process of its own, on copies of its inputs. Its answers are
checked, and its failures become `MapperError`.
"""

from __future__ import annotations

import math
import subprocess
import time
import traceback
from dataclasses import dataclass
from importlib.metadata import distributions
from multiprocessing.connection import Connection
from operator import attrgetter
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, TypeVar

import numpy as np

from lirs_validation.config import DRIVERS, Attitude, MapConfig, RunConfig, driver_parts
from lirs_validation.experiment.loading import interpreter_of, own_mapper, versions_there
from lirs_validation.processes import ChildProcess, Cost, CostMeter, is_interrupt
from lirs_wct import (
    ConfigError,
    FloatArray,
    Imu,
    ImuReadings,
    LaserScan,
    MapperError,
    OccupancyGrid,
    PointCloud,
    Pose2,
    Pose3,
    Trajectory,
    WctError,
    covariance_fault,
    unknown_name,
)
from slam_baselines.mapper import (
    ALL_CLOUD_MAPPERS,
    CLOUD_MAPPERS,
    MAPPERS,
    CloudMapper,
    Mapper,
    MapperStats,
    asks_for,
    make_cloud_mapper,
    make_mapper,
    read_parameters,
    reads_clouds,
)

if TYPE_CHECKING:  # mapping a log does not load the simulator
    from lirs_envs.sensing.sensors import Observation

PATIENCE = 1.0
"""Seconds that a mapper at work is given to tidy up before its process is killed."""
LOST_SECONDS = 5.0
LOST_SCANS = 10
"""A mapper that does not know its place for so long, and during so many scans in a row, has lost it ..."""
LOST_SHARE = 0.05
"""... and so has one that does not know it for more than this share of the scans."""
T = TypeVar("T")
_NUMBERS = {kind: attrgetter(*kind.__match_args__) for kind in (Pose2, Pose3)}
"""Functions that return the numbers of a pose."""


@dataclass(frozen=True, slots=True)
class SensorReadings:
    """Sensor readings at one stamp of a log.

    Attributes:
        scan: Planar scan; None for a mapper of point clouds.
        odometry: `T_odom_base`; None without odometry.
        imu: Inertial reading; None without one.
        cloud: Point cloud; None for a planar mapper.
        inertial: Readings near 200 Hz since the last stamp; None for a mapper that does not take them.
    """

    scan: LaserScan | None = None
    odometry: Pose2 | None = None
    imu: Imu | None = None
    cloud: PointCloud | None = None
    inertial: ImuReadings | None = None


@dataclass(frozen=True, slots=True)
class Estimate:
    """Answer of a mapper to an observation.

    Attributes:
        pose: `T_map_base`, in the plane or in space.
        lost: Whether the mapper does not know its place.
        seconds: Wall-clock time of its update.
        covariance: (3, 3) of x, y, yaw of the pose in the plane; None where the mapper gives none.
    """

    pose: Pose2 | Pose3
    lost: bool
    seconds: float
    covariance: FloatArray | None = None


class MapperUnderTest(Protocol):
    """Interface of a mapper of a run or a log.

    Attributes:
        reads_inertial: Whether it takes all inertial readings.
    """

    name: str
    reads_clouds: bool
    requires_odometry: bool
    reads_inertial: bool

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Give the mapper an observation; return its estimate."""

    def map(self) -> OccupancyGrid:
        """Return the map of a planar mapper."""

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory."""

    @property
    def stats(self) -> MapperStats:
        """Statistics of the mapper."""

    def cost(self) -> Cost:
        """Return the mapper's cost in addition to this process's."""

    def close(self) -> None:
        """Release the mapper's resources."""


class LocalMapper:
    """A planar or cloud mapper in this process (see `MapperUnderTest`).

    Without attitude, the mapper gets no inertial reading: a reading without roll and pitch would still hold
    the direction of gravity.
    """

    def __init__(self, mapper: Mapper | CloudMapper, name: str, attitude: Attitude = "imu") -> None:
        self.name, self._attitude = name, attitude
        self._mapper: Any = mapper
        self.reads_clouds = reads_clouds(mapper)
        self.requires_odometry = asks_for(mapper, "requires_odometry")
        self.reads_inertial = asks_for(mapper, "reads_inertial")
        self._reads_odometry = asks_for(mapper, "reads_odometry")

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Give the mapper an observation; return its estimate."""
        begun = time.perf_counter()
        sensed = observation.cloud if self.reads_clouds else observation.scan
        if sensed is None:
            raise ConfigError("a mapper of point clouds needs a lidar with rings")
        if self.reads_inertial and observation.inertial is None:
            raise ConfigError(f"mapper {self.name!r} needs inertial readings near 200 Hz: there are none")
        imu = observation.imu if self._attitude == "imu" else None
        try:
            if self.reads_clouds:
                further: list[Any] = [observation.inertial] if self.reads_inertial else []
                further += [observation.odometry] if self._reads_odometry else []
                pose = self._mapper.update(sensed, imu, *further)
            else:
                pose = self._mapper.update(sensed, observation.odometry, imu)
        except BaseException as error:
            self._raise_failure("update()", error, f" for the scan at {sensed.stamp:.3f} s")
        kind, where = Pose3 if self.reads_clouds else Pose2, f"for the scan at {sensed.stamp:.3f} s"
        if not isinstance(pose, kind):
            raise MapperError(f"update() must return a {kind.__name__}, got {type(pose).__name__} {where}")
        if not all(map(math.isfinite, _NUMBERS[kind](pose))):
            raise MapperError(f"update() must return a finite pose, got {pose} {where}")
        seconds = time.perf_counter() - begun
        try:
            lost = bool(self._mapper.lost)
        except BaseException as error:
            self._raise_failure("lost", error)
        return Estimate(pose, lost, seconds, self._covariance(where))

    def map(self) -> OccupancyGrid:
        """Return the mapper's map."""
        if self.reads_clouds:
            raise ConfigError("a mapper of point clouds has no occupancy map")
        return self._ask("map()", OccupancyGrid, "map() must return an OccupancyGrid")

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory."""
        trajectory = self._ask("trajectory()", Trajectory, "trajectory() must return a Trajectory")
        finite = np.isfinite(np.column_stack((trajectory.positions, trajectory.quaternions))).all(axis=1)
        if not finite.all():
            raise MapperError(f"trajectory() is not finite at {trajectory.stamps[finite.argmin()]:.3f} s")
        return trajectory

    @property
    def stats(self) -> MapperStats:
        """Statistics of the mapper."""
        return self._ask("stats", MapperStats, "stats must be a MapperStats")

    def cost(self) -> Cost:
        """Return nothing: this process's cost is the mapper's."""
        return Cost(0.0, 0)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _covariance(self, where: str) -> FloatArray | None:
        """Return a copy of the optional covariance, checked."""
        try:
            covariance = getattr(self._mapper, "covariance", None)
            given = None if covariance is None else np.array(covariance, dtype=np.float64)
        except BaseException as error:
            self._raise_failure("covariance", error, f" {where}")
        if given is not None and (fault := covariance_fault(given)):
            raise MapperError(f"{fault} {where}")
        return given

    def _ask(self, part: str, kind: type[T], required: str) -> T:
        """Return the result of a method or property, of a required type."""
        try:
            value = getattr(self._mapper, part.removesuffix("()"))
            value = value() if part.endswith("()") else value
        except BaseException as error:
            self._raise_failure(part, error)
        if not isinstance(value, kind):
            raise MapperError(f"{required}, got {type(value).__name__}")
        return value

    def _raise_failure(self, part: str, error: BaseException, where: str = "") -> NoReturn:
        """Raise the error for a failure; a Ctrl-C and our own errors stay unchanged."""
        if is_interrupt(error):
            raise KeyboardInterrupt from error
        if isinstance(error, WctError):
            raise error
        kind = ": ".join(filter(None, (type(error).__name__, str(error))))
        raise MapperError(f"mapper {self.name!r}: {part} failed{where}: {kind}") from error


class LostRule:
    """Rule that decides scan by scan whether a mapper is lost."""

    def __init__(self) -> None:
        self._scans = self._lost = self._in_a_row = 0
        self._begun = self._longest = self._longest_begun = 0.0

    def observe(self, stamp: float, lost: bool) -> None:
        """Take in whether the mapper knew its place after the scan of a stamp, seconds."""
        self._scans += 1
        if not lost:
            self._in_a_row = 0
            return
        self._lost += 1
        self._begun = self._begun if self._in_a_row else stamp
        self._in_a_row += 1
        seconds = stamp - self._begun
        if self._in_a_row >= LOST_SCANS and seconds >= max(LOST_SECONDS, self._longest):
            self._longest, self._longest_begun = seconds, self._begun

    @property
    def too_long(self) -> str | None:
        """Message about the longest loss; None below 5 s or 10 scans."""
        if self._longest == 0.0:
            return None
        return f"the mapper lost its place at {self._longest_begun:.1f} s for {self._longest:.1f} s"

    def reason(self) -> str | None:
        """Return why the mapper is lost; None if it is not.

        The time and the share of all scans so far count.
        """
        share = self._lost / self._scans if self._scans else 0.0
        if self.too_long is None and share <= LOST_SHARE:
            return None
        counted = f"{self._lost} of {self._scans} scans ({100 * share:.1f} %)"
        if self.too_long is None:
            return f"the mapper did not know its place during {counted}"
        return f"{self.too_long}; it did not know it during {counted}"


def check_sensors(mapper: MapperUnderTest, config: RunConfig) -> None:
    """Check that a run's lidar and driver suit its mapper.

    Any lidar suits a planar mapper: of one with rings it gets the ring nearest the horizon.
    """
    # Mapping a log does not load the simulator.
    from lirs_envs.lidar.presets import RING_LIDARS, make_lidar_preset
    from lirs_envs.robots.robot import make_robot

    lidar = make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    if not mapper.reads_clouds:
        return
    if lidar.rings == 1:
        raise ConfigError(
            f"mapper {config.mapper} needs a lidar with rings, got {lidar.name}; "
            f"legal: --lidar {' or '.join(RING_LIDARS)}"
        )
    if driver_parts(config.driver)[0] == "frontier":
        raise ConfigError(
            f"driver frontier plans on the mapper's occupancy map, and {config.mapper} has none; "
            f"legal: {', '.join(name for name in DRIVERS if name != 'frontier')}"
        )


def needs_process(mapper: str) -> bool:
    """Whether a mapper is foreign code: `module:name`, or an adapter of a compiled system."""
    return ":" in mapper or mapper in CLOUD_MAPPERS


def start_mapper(config: RunConfig) -> MapperUnderTest:
    """Return the mapper of a run, in its own process if it is foreign code."""
    if needs_process(config.mapper):
        return MapperProcess(config)
    if config.mapper_python is not None:
        interpreter_of(config.mapper, config.mapper_python)
    mapper = mapper_named(config.mapper, config.seed, config.parameters)
    return LocalMapper(mapper, config.mapper, config.attitude)


def mapper_named(name: str, seed: int, parameters: str = "") -> Mapper | CloudMapper:
    """Create a mapper by its name, or by `module:name` of your own class."""
    options = read_parameters(parameters)
    if name in MAPPERS:
        return make_mapper(name, seed=seed, **options)
    if name in ALL_CLOUD_MAPPERS:
        return make_cloud_mapper(name, seed=seed, **options)
    if ":" not in name:
        raise unknown_name("mapper", name, [*MAPPERS, *ALL_CLOUD_MAPPERS, "module:name of your own"])
    return own_mapper(name, seed, options)


def package_versions(mapper: str, interpreter: str | None = None) -> dict[str, str]:
    """Return the versions of a mapper's own packages where it runs; empty for our methods."""
    method = CLOUD_MAPPERS.get(mapper)
    if method is None:
        return {}
    package = method.distribution
    if interpreter is None:
        version = next((each.version for each in distributions(name=package)), "")
    else:
        version = versions_there(interpreter_of(mapper, interpreter), package)[1]
    return {package: version} if version else {}


class MapperProcess:
    """A mapper in another process, which ends with this object (see `MapperUnderTest`)."""

    def __init__(self, config: RunConfig | MapConfig) -> None:
        self.name = config.mapper
        third_party = config.mapper in CLOUD_MAPPERS
        self._errors = TemporaryFile() if third_party else None  # noqa: SIM115 (it outlives this method)
        outputs = {"stdout": subprocess.DEVNULL, "stderr": self._errors} if third_party else {}
        try:
            path = config.mapper_python
            python = None if path is None else interpreter_of(config.mapper, path)
            self._child = ChildProcess(f"{__name__}:serve_mapper", PATIENCE, python, **outputs)
        except OSError as error:
            raise MapperError(f"mapper {config.mapper!r}: its process cannot be started ({error})") from error
        try:
            abilities = self._request("make", config.mapper, config.seed, config.parameters, config.attitude)
        except BaseException:
            self.close()  # a traceback may keep this object for long
            raise
        self.reads_clouds, self.requires_odometry, self.reads_inertial = abilities

    def observe(self, observation: Observation | SensorReadings) -> Estimate:
        """Send the mapper an observation; wait for its estimate."""
        o = observation
        scan, cloud = (None, o.cloud) if self.reads_clouds else (o.scan, None)
        inertial = o.inertial if self.reads_inertial else None
        estimate: Estimate = self._request(
            "observe", SensorReadings(scan, o.odometry, o.imu, cloud, inertial)
        )
        return estimate

    def map(self) -> OccupancyGrid:
        """Return the mapper's map."""
        grid: OccupancyGrid = self._request("map")
        return grid

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory."""
        trajectory: Trajectory = self._request("trajectory")
        return trajectory

    @property
    def stats(self) -> MapperStats:
        """Statistics of the mapper."""
        stats: MapperStats = self._request("stats")
        return stats

    def cost(self) -> Cost:
        """Return the cost of the process since its first scan."""
        cost: Cost = self._request("cost")
        return cost

    def close(self) -> None:
        """End the process; a mapper that is at work is interrupted."""
        self._child.end()

    def _request(self, part: str, *arguments: Any) -> Any:
        try:
            self._child.pipe.send((part, *arguments))
            value, error = self._child.pipe.recv()
        except (EOFError, OSError):
            raise self._death() from None
        if error is not None:
            raise error
        return value

    def _death(self) -> MapperError:
        """Return the error of a process that has ended, with its last line."""
        how = self._child.cause_of_death()
        memory = "; the system may have lacked memory" if how.endswith("SIGKILL") else ""
        last = ""
        if self._errors is not None:
            self._errors.seek(0)
            lines = self._errors.read().decode(errors="replace").split("\n")
            last = next((f": {line.strip()}" for line in reversed(lines) if line.strip()), "")
        return MapperError(f"mapper {self.name!r}: its process ended ({how}{memory}){last}")


def serve_mapper(pipe: Connection) -> None:
    """Make the mapper of the first message; return the parts that further messages name."""
    mapper: LocalMapper | None = None
    meter: CostMeter | None = None
    while True:
        part, *arguments = pipe.recv()
        value: object = None
        failure: Exception | None = None
        try:
            if mapper is None:
                name, seed, parameters, attitude = arguments
                mapper = LocalMapper(mapper_named(name, seed, parameters), name, attitude)
                value = mapper.reads_clouds, mapper.requires_odometry, mapper.reads_inertial
            elif part == "cost":
                value = (meter or CostMeter()).cost()
            else:
                meter = meter or CostMeter()
                member = getattr(mapper, part)
                value = member(*arguments) if callable(member) else member
        except Exception as error:
            ours = type(error).__module__ == WctError.__module__
            failure = error if ours else MapperError(str(error))  # others may not be serializable
            failure.add_note(f"In the mapper's process:\n{''.join(traceback.format_exception(error))}")
        pipe.send((value, failure))
