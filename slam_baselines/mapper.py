"""Protocols of mappers and localizers, their statistics, their construction by name, and their warm-up."""

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
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, TypeGuard

import numpy as np

from lirs_wct.errors import ConfigError, require_known
from lirs_wct.geometry import FloatArray, Imu, LaserScan, OccupancyGrid, PointCloud, Pose2, Pose3, Trajectory


class Method(NamedTuple):
    """SLAM method by name, so that one method does not import the others.

    Attributes:
        factory: Name of the callable that makes a mapper of a configuration.
        resolution: Field of the configuration that is the edge of the map's cell, meters; empty = none.
        package: Import name of a needed package that is none of our dependencies.
        extra: Our extra that installs it; empty = none does.
        needs: Sensors' data besides point clouds.
        options: Fixed fields of its configuration.
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
            return f"pip install --no-deps {self.distribution}"
        return f"pip install 'lirs-wct[{self.extra}]'"

    @property
    def distribution(self) -> str:
        """The package as pip calls it."""
        return self.package.replace("_", "-")

    @property
    def installed(self) -> bool:
        """Whether the needed package is installed."""
        return not self.package or find_spec(self.package) is not None


_CLOUDS, _ORIGINALS = "lirs_extensions.clouds", "lirs_extensions.originals"


def _original(module: str, method: str, resolution: str) -> Method:
    """Return a method as published."""
    name = f"{method}Original"
    return Method(f"{_ORIGINALS}.{module}", f"{name}Config", f"{name}Mapper", resolution)


MAPPERS: Mapping[str, Method] = {
    "hector": Method("slam_baselines.hector", "HectorConfig", "HectorMapper", "map_resolution"),
    "hector_original": _original("hector", "Hector", "map_resolution"),
    "gmapping": Method("slam_baselines.gmapping.mapper", "GmappingConfig", "GmappingMapper", "delta"),
    "gmapping_original": _original("gmapping.mapper", "Gmapping", "delta"),
    "cartographer": Method(
        "slam_baselines.cartographer.mapper", "CartographerConfig", "make_cartographer", "map_resolution"
    ),
    "cartographer_original": _original("cartographer.mapper", "Cartographer", "resolution"),
    "slam_toolbox_original": _original("slam_toolbox.mapper", "SlamToolbox", "resolution"),
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
        received: Scans given to it.
        used: Scans that moved its estimate.
        skipped: Scans left out, by reason.
        lost: Scans during which it did not know where it was.
        ms_p50: Median wall time of an update, milliseconds; 0 before the first.
        ms_p95: 95th percentile of it.
        ms_max: Longest wall time of an update.
        memory: Bytes of its maps.
        counts: Other counts of the method (searches, map updates, particles, constraints).
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


class Mapper(Estimator, Protocol):
    """Simultaneous localization and mapping; the map frame is the first base pose.

    Attitude and odometry are used where they are given. Two attributes are optional. `requires_odometry` says
    that scans without odometry are refused. `covariance` after `update`, (3, 3) or None, is that of the error
    of the returned `T_map_base` since the start: x and y in the axes of the map frame, meters, and yaw,
    radians. A mapper of point clouds gives that of its pose in the plane.
    """

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Take in a scan and return `T_map_base` at its stamp.

        Args:
            scan: Scan from the sensor.
            odometry: Absolute `T_odom_base` at the scan's stamp, if there is odometry.
            imu: Attitude at the scan's stamp, if there is one.
        """
        ...

    def map(self) -> OccupancyGrid:
        """Return the map in the map frame."""
        ...


class Localizer(Mapper, Protocol):
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
            imu: Inertial reading at the cloud's stamp, if there is one.
        """
        ...


def asks_for(mapper: object, attribute: str) -> bool:
    """Return whether an optional attribute such as `requires_odometry` is true; False without it."""
    return bool(getattr(mapper, attribute, False))


def reads_clouds(mapper: object) -> TypeGuard[CloudMapper]:
    """Return whether a mapper takes point clouds."""
    return asks_for(mapper, "reads_clouds")


def required_odometry(mapper: str, odometry: Pose2 | None, stamp: float) -> Pose2:
    """Return the odometry at a scan's stamp."""
    if odometry is None:
        raise ConfigError(f"{mapper} needs odometry, the scan at {stamp} s has none; hector maps without")
    return odometry


def parameters(name: str) -> tuple[str, ...]:
    """Return the names of a method's parameters, those of its configuration."""
    return tuple(each.name for each in fields(_default_config(name)))


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
        ConfigError: no mapper has that name, its package is missing, or its configuration has no such field
            or not that value.
    """
    require_known("mapper of point clouds", name, ALL_CLOUD_MAPPERS)
    method = ALL_CLOUD_MAPPERS[name]
    if not method.installed:
        raise ConfigError(f"mapper {name} needs the package {method.distribution}: {method.install}")
    mapper: CloudMapper = _make(name, seed, config)
    return mapper


_METHODS = {**MAPPERS, **ALL_CLOUD_MAPPERS}
NUMBERS = ((bool, bool, "true or false"), (int, Integral, "a whole number"), (float, Real, "a number"))
"""Kinds of a parameter's default, what is legal for each, and its words; a bool is an int too."""


def _default_config(name: str) -> Any:
    """Return the default configuration of a method."""
    require_known("mapper", name, _METHODS)
    method = _METHODS[name]
    return getattr(importlib.import_module(method.module), method.config)(**method.options)


def _make(name: str, seed: int | None, values: dict[str, Any]) -> Any:
    """Return a new mapper whose configuration has some values other than the defaults."""
    defaults, legal, method = _default_config(name), parameters(name), _METHODS[name]
    if seed is not None and "seed" in legal:
        values["seed"] = seed
    for key, value in values.items():
        require_known(f"parameter of {name}", key, legal)
        default = getattr(defaults, key)
        for kind, number, words in NUMBERS:
            if isinstance(default, kind):
                if not isinstance(value, number) or (isinstance(value, bool) and kind is not bool):
                    raise ConfigError(f"{key} of {name} must be {words}, got {value!r}")
                break
        if isinstance(value, float) and not math.isfinite(value) and value != default:
            raise ConfigError(f"{key} of {name} must be a finite number, got {value}")
    try:
        config = replace(defaults, **values)
        return getattr(importlib.import_module(method.module), method.factory)(config)
    except TypeError as error:
        raise ConfigError(f"configuration of {name}: {error}") from error


def read_parameters(text: str, label: str = "--parameters") -> dict[str, Any]:
    """Return names and values of a text such as `srr=0.1,particles=20`; of "" none."""
    values: dict[str, Any] = {}
    for part in text.split(",") if text else ():
        name, _, value = (word.strip() for word in part.partition("="))
        if not name or not value or name in values:
            raise ConfigError(f"{label} must be NAME=VALUE,NAME=VALUE,... with different names, got {text!r}")
        values[name] = {"true": True, "false": False}.get(value, value)
        for kind in (float, int):
            with suppress(ValueError):
                values[name] = kind(value)
    return values


def parameter_text(text: str, label: str = "--parameters") -> str:
    """Return parameters as a text; of a ROS parameter file those that it changes."""
    if text.endswith((".yaml", ".yml")):
        text = importlib.import_module(MAPPERS["slam_toolbox_original"].module).read_ros_file(Path(text))
    return text


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

    def add_to(self, stats: MapperStats) -> MapperStats:
        """Return statistics with the times of the updates."""
        if not self._ms:
            return stats
        p50, p95, most = np.percentile(self._ms, (50, 95, 100)).tolist()
        return replace(stats, ms_p50=p50, ms_p95=p95, ms_max=most)


class PlanarMapper(ABC):
    """Estimator of a pose from planar scans that counts and times them.

    Attributes:
        name: Name of the method, as in MAPPERS.
        requires_odometry: Whether scans without odometry are refused.
        received: Scans so far.
        lost: Whether the pose is unknown; set by `process`.
        covariance: (3, 3) of `T_map_base`, see `Mapper`; set by `process`, None = not known.
        lost_scans: Scans during which the pose was unknown.
    """

    name = ""
    requires_odometry = False
    lost = False
    covariance: FloatArray | None = None

    def __init__(self) -> None:
        self.received = self.lost_scans = 0
        self._stopwatch = Stopwatch()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Process a scan; return `T_map_base` at its stamp.

        Raises:
            ConfigError: there is no odometry, and the method requires it; or odometry or IMU are not finite.
        """
        o, i = odometry or Pose2(), imu or Imu()
        total = i.stamp + i.roll + i.pitch + sum(i.angular_velocity) + sum(i.linear_acceleration)
        if not math.isfinite(o.x + o.y + o.yaw + total):  # a compiled loop computes cells of them
            raise ConfigError(f"odometry and inertial readings must be finite, got {odometry}, {imu}")
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
        stats = replace(self.counts(), received=self.received, lost=self.lost_scans)
        return self._stopwatch.add_to(stats)


BEAMS, FOV, RANGE = 541, math.radians(270), 20.0
CORNERS = np.array((-6 - 4j, 6 - 4j, 6 + 4j, 1 + 4j, 1 + 2.5j, 2.5j, 4j, -6 + 4j, -6 - 4j))
"""Corners x + y i of the room, with a pillar in its northern wall, meters."""
MOUNT = Pose3(0.2, 0.0, 0.3)
RADIUS, STEP = 2.2, 0.12
"""Radius of the circle that is driven, and distance between scans, meters."""


def warm_up(name: str, **config: Any) -> None:
    """Run a new mapper through a short synthetic drive that compiles its kernels.

    The robot circles a room, on a floor and on uneven ground, until it is back in a known place. Then it is
    displaced, so that the rarely used parts (wider search, loop closure) are compiled too. A method's module
    may name in `WARM_UP` the configuration with which this drive reaches all kernels; `config` shortens it.
    """
    config = {**getattr(importlib.import_module(MAPPERS[name].module), "WARM_UP", {}), **config}
    for uneven in (False, True):
        mapper = make_mapper(name, **config)
        start = room_pose(0.0)
        laps = np.arange(0.0, 2.6 * math.pi, STEP / RADIUS)
        for k, angle in enumerate(laps):
            pose = room_pose(angle)
            jump = Pose2(0.4, 0.3, 0.5) if k == len(laps) - 3 else Pose2()
            tilt = 0.03 * math.sin(3 * angle) if uneven else 0.0
            stamp = 0.2 * k
            imu = Imu(pitch=tilt, stamp=stamp) if uneven else None
            mapper.update(room_scan(pose @ jump, stamp), start.inverse() @ pose, imu)
        mapper.map()
        mapper.trajectory()


def room_pose(angle: float) -> Pose2:
    """Return a pose on the circle that is driven, at an angle in radians."""
    return Pose2(RADIUS * math.cos(angle) - 1, RADIUS * math.sin(angle) - 1, angle + math.pi / 2)


def room_scan(T_room_base: Pose2, stamp: float) -> LaserScan:
    """Return the scan of the room's outline by a scanner on the base."""
    T_room_laser = T_room_base @ Pose2(MOUNT.x, MOUNT.y)
    angles = T_room_laser.yaw - FOV / 2 + FOV / (BEAMS - 1) * np.arange(BEAMS)
    beams, edges = np.exp(1j * angles)[:, None], np.diff(CORNERS)
    corners = CORNERS[:-1] - complex(T_room_laser.x, T_room_laser.y)
    across = (beams.conj() * edges).imag
    with np.errstate(divide="ignore", invalid="ignore"):
        distance, along = (corners.conj() * edges).imag / across, (corners.conj() * beams).imag / across
    hit = (distance > 0) & (along >= 0) & (along <= 1)
    ranges = np.where(hit, distance, np.inf).min(axis=1).astype(np.float32)
    return LaserScan(ranges, -FOV / 2, FOV / (BEAMS - 1), 0.1, RANGE, stamp, MOUNT)
