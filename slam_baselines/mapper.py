"""Protocols of mappers and localizers, their statistics, and their construction by name."""

from __future__ import annotations

import importlib
import math
import time
from abc import ABC, abstractmethod
from array import array
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from importlib.util import find_spec
from numbers import Integral, Real
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, TypedDict, TypeGuard

import numpy as np

from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, PointCloud, Pose2, Pose3, Trajectory


class Method(NamedTuple):
    """SLAM method by name, so that one method does not import the others.

    Attributes:
        module: Module of the mapper.
        config: name of the class of its configuration.
        factory: name of the callable that makes a mapper of a configuration.
        resolution: field of the configuration that is the edge of the map's cell, meters; empty = none.
        package: import name of a needed package that is none of our dependencies.
        extra: Our extra that installs it; empty = none does.
        license: License of the package.
        needs: Sensors' data besides point clouds.
        options: fixed fields of its configuration.
    """

    module: str
    config: str
    factory: str
    resolution: str = ""
    package: str = ""
    extra: str = ""
    license: str = ""
    needs: str = ""
    options: Mapping[str, Any] = MappingProxyType({})

    @property
    def install(self) -> str:
        """Command that installs the needed package."""
        if not self.extra:
            return f"pip install . {self.distribution} into an environment, --mapper-python ITS/bin/python"
        return f"pip install '.[{self.extra}]'"

    @property
    def distribution(self) -> str:
        """The package as pip calls it."""
        return self.package.replace("_", "-")

    @property
    def installed(self) -> bool:
        """Whether the needed package is installed."""
        return not self.package or find_spec(self.package) is not None


_CLOUDS, _ORIGINALS = "lirs_extensions.clouds", "lirs_extensions.originals"

MAPPERS: Mapping[str, Method] = {
    "hector": Method("slam_baselines.hector", "HectorConfig", "HectorMapper", "map_resolution"),
    "hector_original": Method(
        f"{_ORIGINALS}.hector", "HectorOriginalConfig", "HectorOriginalMapper", "map_resolution"
    ),
    "gmapping": Method("slam_baselines.gmapping.mapper", "GmappingConfig", "GmappingMapper", "delta"),
    "gmapping_original": Method(
        f"{_ORIGINALS}.gmapping.mapper", "GmappingOriginalConfig", "GmappingOriginalMapper", "delta"
    ),
    "cartographer": Method(
        "slam_baselines.cartographer.mapper", "CartographerConfig", "make_cartographer", "map_resolution"
    ),
    "cartographer_original": Method(
        f"{_ORIGINALS}.cartographer.mapper",
        "CartographerOriginalConfig",
        "CartographerOriginalMapper",
        "resolution",
    ),
}
"""The planar methods by name."""

_INERTIAL = "inertial readings, a start at rest"


def _evalio(pipeline: str, needs: str = "") -> Method:
    """Return a pipeline that is compiled into the package evalio."""
    return Method(
        f"{_CLOUDS}.evalio",
        "EvalioConfig",
        "make_evalio",
        package="evalio",
        license="MIT, pipeline's own",
        needs=needs,
        options={"pipeline": pipeline},
    )


def _wrap_package(
    package: str, config: str, *, module: str = f"{_CLOUDS}.packages", needs: str = ""
) -> Method:
    """Return a system that the authors' package of its name holds."""
    factory = f"make_{package}"
    return Method(module, config, factory, package=package, extra="slam", license="MIT", needs=needs)


CLOUD_MAPPERS: Mapping[str, Method] = {
    "kiss-icp": _wrap_package("kiss_icp", "KissIcpConfig", module="slam_baselines.kiss_icp"),
    "genz-icp": _wrap_package("genz_icp", "GenzIcpConfig"),
    "small-gicp": _wrap_package("small_gicp", "SmallGicpConfig"),
    "rko-lio": _wrap_package("rko_lio", "RkoLioConfig", needs=_INERTIAL),
    "evalio:ct": _evalio("ct", "rolling sweeps"),
    "evalio:dlio": _evalio("dlio", _INERTIAL),
    "evalio:form": _evalio("form", "organized clouds"),
    "evalio:genz": _evalio("genz"),
    "evalio:kiss": _evalio("kiss", "rolling sweeps"),
    "evalio:liosam": _evalio("liosam", f"organized clouds, {_INERTIAL}"),
    "evalio:loam": _evalio("loam", "organized clouds"),
    "evalio:mad": _evalio("mad"),
}
"""Third-party systems that read point clouds, by name; none of them is among our dependencies."""

OWN_CLOUD_MAPPERS: Mapping[str, Method] = {
    "wheel_lio": Method(
        f"{_CLOUDS}.wheel_lio.mapper",
        "WheelLioConfig",
        "WheelLioMapper",
        license="ours",
        needs="odometry, inertial readings",
    )
}
"""Our methods that read point clouds, by name."""
ALL_CLOUD_MAPPERS = {**OWN_CLOUD_MAPPERS, **CLOUD_MAPPERS}
"""All methods that read point clouds, by name."""


def short_name(mapper: str) -> str:
    """Return a mapper's name in sentences: a class of your own without its module."""
    return mapper if mapper in ALL_CLOUD_MAPPERS else mapper.rpartition(":")[2]


def file_name(mapper: str) -> str:
    """Return a mapper's name in names of folders."""
    return short_name(mapper).replace(":", "-")


@dataclass(frozen=True, kw_only=True)
class MapperStats:
    """Counts, times and memory of a mapper so far.

    Attributes:
        received: scans given to it.
        used: scans that moved its estimate.
        skipped: scans left out, by reason.
        lost: scans during which it did not know where it was.
        ms_p50: median wall time of an update, milliseconds; 0 before the first.
        ms_p95: 95th percentile of an update's wall time.
        ms_max: the longest.
        memory: bytes of its maps.
        counts: other counts of the method (searches, map updates, particles, constraints).
        weak_directions: a digit per scan, 0 to 6: directions of motion that it did not constrain, and that
            other sensors decided. Empty = the method does not tell.
    """

    received: int = 0
    used: int = 0
    skipped: Mapping[str, int] = field(default_factory=dict)
    lost: int = 0
    ms_p50: float = 0.0
    ms_p95: float = 0.0
    ms_max: float = 0.0
    memory: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    weak_directions: str = ""


class Estimator(Protocol):
    """Estimator of a robot's path."""

    def trajectory(self) -> Trajectory:
        """Return the final pose of every scan or cloud."""
        ...

    @property
    def stats(self) -> MapperStats:
        """Counts, times and memory so far; a cloud counts as a scan."""
        ...

    @property
    def lost(self) -> bool:
        """Whether the pose is unknown at present."""
        ...


class PoseEstimator(Estimator, Protocol):
    """Estimator of a robot's pose, one scan after the other.

    Attitude and odometry are used where they are given. The optional attribute `requires_odometry` says that
    scans without odometry are refused.
    """

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Take in a scan and return `T_map_base` at its stamp.

        Args:
            scan: Scan from the sensor.
            odometry: Absolute `T_odom_base` at the scan's stamp, if there is odometry.
            imu: Attitude at the scan's stamp, if there is one.
        """
        ...


class Mapper(PoseEstimator, Protocol):
    """Simultaneous localization and mapping; the map frame is the first base pose."""

    def map(self) -> OccupancyGrid:
        """Return the map in the map frame."""
        ...


class Localizer(PoseEstimator, Protocol):
    """Localization in a known map; the map frame is the known map's."""

    @property
    def known_map(self) -> OccupancyGrid:
        """Known map, never changed."""
        ...


class CloudMapper(Estimator, Protocol):
    """Localization and mapping in space from the clouds of a lidar with rings.

    The map frame is the first base pose, tilted as the robot stood. The mapper needs no map: it is made from
    the clouds at the poses of the trajectory.
    """

    @property
    def reads_clouds(self) -> bool:
        """True: `update` takes clouds, and not planar scans."""
        ...

    def update(self, cloud: PointCloud, imu: Imu | None) -> Pose3:
        """Take in a sweep and return `T_map_base` at its stamp.

        Two optional attributes ask for further arguments, in this order. With `reads_inertial = True` there
        is `ImuReadings`: all readings near 200 Hz since the last sweep. With `reads_odometry = True` there
        is `Pose2 | None`: the absolute `T_odom_base` at the cloud's stamp.

        Args:
            cloud: Cloud in the sensor's frame.
            imu: inertial reading at the cloud's stamp, if there is one.
        """
        ...


def reads_clouds(mapper: object) -> TypeGuard[CloudMapper]:
    """Return whether a mapper takes point clouds; False without the attribute."""
    return bool(getattr(mapper, "reads_clouds", False))


def reads_inertial(mapper: object) -> bool:
    """Return whether a cloud mapper takes all inertial readings; False without the attribute."""
    return reads_clouds(mapper) and bool(getattr(mapper, "reads_inertial", False))


def reads_odometry(mapper: object) -> bool:
    """Return whether a cloud mapper takes the odometry; False without the attribute."""
    return reads_clouds(mapper) and bool(getattr(mapper, "reads_odometry", False))


def requires_odometry(mapper: object) -> bool:
    """Return whether a mapper refuses scans without odometry; False without the attribute."""
    return bool(getattr(mapper, "requires_odometry", False))


def required_odometry(mapper: str, odometry: Pose2 | None, stamp: float) -> Pose2:
    """Return the odometry at a scan's stamp.

    Raises:
        ConfigError: there is none.
    """
    if odometry is None:
        raise ConfigError(f"{mapper} needs odometry, the scan at {stamp} s has none; hector maps without")
    return odometry


def check_motion(odometry: Pose2 | None, imu: Imu | None) -> None:
    """Check that odometry and attitude are finite, before a compiled loop computes cells of them.

    Raises:
        ConfigError: they are not.
    """
    o, i = odometry or Pose2(), imu or Imu()
    total = i.stamp + i.roll + i.pitch + sum(i.angular_velocity) + sum(i.linear_acceleration)
    if not math.isfinite(o.x + o.y + o.yaw + total):
        raise ConfigError(f"odometry and inertial readings must be finite, got {odometry}, {imu}")


def parameters(name: str) -> tuple[str, ...]:
    """Return the names of a method's parameters, those of its configuration.

    Raises:
        ConfigError: no mapper has that name.
    """
    return tuple(each.name for each in fields(_config_class(name)))


def make_mapper(
    name: str, *, seed: int | None = None, resolution: float | None = None, **config: Any
) -> Mapper:
    """Make a planar mapper by its name.

    A `map` in cartographer's configuration makes it a Localizer as well.

    Args:
        name: One of MAPPERS.
        seed: Seed of the random numbers, for a method that draws any.
        resolution: Edge of the map's cell, meters, under any method's name for it.
        **config: Fields of the method's configuration.

    Raises:
        ConfigError: no mapper has that name, or its configuration no such field or not that value.
    """
    if name in ALL_CLOUD_MAPPERS:
        raise ConfigError(f"{name} reads point clouds, planar mappers are {', '.join(MAPPERS)}")
    if resolution is not None and name in MAPPERS:
        config[MAPPERS[name].resolution] = resolution
    mapper: Mapper = _make(name, seed, config)
    return mapper


def make_cloud_mapper(name: str, *, seed: int | None = None, **config: Any) -> CloudMapper:
    """Make a mapper that reads point clouds by its name.

    Args:
        name: One of ALL_CLOUD_MAPPERS.
        seed: Seed of the random numbers, for a method that draws any.
        **config: Fields of the method's configuration.

    Raises:
        ConfigError: no such mapper has that name, its package is not installed, or its configuration has no
            such field or not that value.
    """
    if name not in ALL_CLOUD_MAPPERS:
        raise unknown_name("mapper of point clouds", name, ALL_CLOUD_MAPPERS)
    method = ALL_CLOUD_MAPPERS[name]
    if not method.installed:
        raise ConfigError(f"mapper {name} needs the package {method.distribution}: {method.install}")
    mapper: CloudMapper = _make(name, seed, config)
    return mapper


_METHODS = {**MAPPERS, **ALL_CLOUD_MAPPERS}


def _config_class(name: str) -> Any:
    """Return the class of a method's configuration."""
    if name not in _METHODS:
        raise unknown_name("mapper", name, _METHODS)
    method = _METHODS[name]
    return getattr(importlib.import_module(method.module), method.config)


def _make(name: str, seed: int | None, values: dict[str, Any]) -> Any:
    """Return a new mapper whose configuration has some values other than the defaults."""
    config_class, legal = _config_class(name), parameters(name)
    method = _METHODS[name]
    if seed is not None and "seed" in legal:
        values["seed"] = seed
    defaults = config_class(**method.options)
    for key, value in values.items():
        if key not in legal:
            raise unknown_name(f"parameter of {name}", key, legal)
        _check_kind(getattr(defaults, key), value, f"{key} of {name}")
    try:
        config = replace(defaults, **values)
        return getattr(importlib.import_module(method.module), method.factory)(config)
    except TypeError as error:
        raise ConfigError(f"configuration of {name}: {error}") from error


def _check_kind(default: Any, value: Any, label: str) -> None:
    """Check that a value is of the default's kind of number."""
    kinds = ((bool, bool, "true or false"), (int, Integral, "a whole number"), (float, Real, "a number"))
    for kind, legal, words in kinds:
        if isinstance(default, kind):
            if not isinstance(value, legal) or (isinstance(value, bool) and kind is not bool):
                raise ConfigError(f"{label} must be {words}, got {value!r}")
            return


def read_parameters(text: str, label: str = "--parameters") -> dict[str, Any]:
    """Return names and values of a text such as `srr=0.1,particles=20`; of "" none.

    Raises:
        ConfigError: the text is no such list.
    """
    values: dict[str, Any] = {}
    for part in text.split(",") if text else ():
        name, _, value = (word.strip() for word in part.partition("="))
        if not name or not value or name in values:
            raise ConfigError(f"{label} must be NAME=VALUE,NAME=VALUE,... with different names, got {text!r}")
        values[name] = _read_value(value)
    return values


def _read_value(text: str) -> Any:
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return {"true": True, "false": False}.get(text, text)


class Times(TypedDict, total=False):
    """Times of MapperStats; empty before the first update."""

    ms_p50: float
    ms_p95: float
    ms_max: float


class Stopwatch:
    """Wall times of updates, milliseconds."""

    def __init__(self) -> None:
        self._ms = array("d")

    def start(self) -> int:
        """Return the time now, nanoseconds."""
        return time.perf_counter_ns()

    def stop(self, started: int) -> None:
        """Record the time since `started`."""
        self._ms.append((time.perf_counter_ns() - started) * 1e-6)

    def summary(self) -> Times:
        """Return the times of MapperStats."""
        if not self._ms:
            return {}
        p50, p95, most = np.percentile(self._ms, (50, 95, 100))
        return {"ms_p50": float(p50), "ms_p95": float(p95), "ms_max": float(most)}


class PlanarMapper(ABC):
    """Estimator of a pose from planar scans that counts and times them.

    Attributes:
        name: Name of the method, as in MAPPERS.
        requires_odometry: Whether scans without odometry are refused.
        received: Scans so far.
        lost: Whether the pose is unknown; set by `process`.
        lost_scans: Scans during which the pose was unknown.
    """

    name = ""
    requires_odometry = False
    lost = False

    def __init__(self) -> None:
        self.received = self.lost_scans = 0
        self._stopwatch = Stopwatch()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Process a scan; return `T_map_base` at its stamp.

        Raises:
            ConfigError: there is no odometry, and the method requires it; or odometry or IMU are not finite.
        """
        check_motion(odometry, imu)
        if self.requires_odometry:
            odometry = required_odometry(self.name, odometry, scan.stamp)
        started = self._stopwatch.start()
        self.received += 1
        pose = self.process(scan, odometry, imu)
        self.lost_scans += self.lost
        self._stopwatch.stop(started)
        return pose

    @abstractmethod
    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Process a scan as the method does; return `T_map_base`."""

    @abstractmethod
    def counts(self) -> MapperStats:
        """Return the method's part of the statistics: used and skipped scans, memory, other counts."""

    @property
    def stats(self) -> MapperStats:
        """Counts, times and memory so far."""
        times = self._stopwatch.summary()
        return replace(self.counts(), received=self.received, lost=self.lost_scans, **times)
