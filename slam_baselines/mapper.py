"""Protocols of mappers and localizers, and how to make one by its name."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory


class Method(NamedTuple):
    """A SLAM method, by name and not by import: one method must not drag in the others.

    Attributes:
        module: of its mapper.
        config: name of the class of its configuration.
        factory: name of what makes a mapper of a configuration.
        resolution: field of the configuration that is the edge of the map's cell, metres.
    """

    module: str
    config: str
    factory: str
    resolution: str


MAPPERS: Mapping[str, Method] = {
    "hector": Method("slam_baselines.hector.mapper", "HectorConfig", "HectorMapper", "map_resolution"),
    "hector_original": Method(
        "slam_baselines.hector.original", "HectorOriginalConfig", "HectorOriginalMapper", "map_resolution"
    ),
    "gmapping": Method("slam_baselines.gmapping.mapper", "GmappingConfig", "GmappingMapper", "delta"),
    "gmapping_original": Method(
        "slam_baselines.gmapping.original.mapper", "GmappingOriginalConfig", "GmappingOriginalMapper", "delta"
    ),
    "cartographer": Method(
        "slam_baselines.cartographer.mapper", "CartographerConfig", "make_cartographer", "map_resolution"
    ),
    "cartographer_original": Method(
        "slam_baselines.cartographer.original",
        "CartographerOriginalConfig",
        "CartographerOriginalMapper",
        "map_resolution",
    ),
}
"""The methods by name."""


@dataclass(frozen=True, kw_only=True)
class MapperStats:
    """What a mapper has done so far.

    Attributes:
        received: scans given to it.
        used: scans that moved its estimate.
        skipped: scans left out, by reason.
        lost: scans during which it did not know where it was.
        ms_p50: median wall time of an update, milliseconds; 0 before the first.
        ms_p95: its 95th percentile.
        ms_max: the longest.
        memory: bytes of its maps.
        counts: what else the method counts (searches, map updates, particles, constraints).
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


class PoseEstimator(Protocol):
    """Estimator of a robot's pose, one scan after the other.

    Attitude and odometry help where they are given. An optional attribute `requires_odometry` says that scans
    without odometry are refused.
    """

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Take in a scan and return `T_map_base` at its stamp.

        Args:
            scan: as the sensor gave it.
            odometry: absolute `T_odom_base` at the scan's stamp, if there is odometry.
            imu: attitude at the scan's stamp, if there is one.
        """
        ...

    def trajectory(self) -> Trajectory:
        """Return the final pose of every scan."""
        ...

    @property
    def stats(self) -> MapperStats:
        """What was done so far."""
        ...

    @property
    def lost(self) -> bool:
        """Whether the pose is unknown at present."""
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
        """The known map, which stays as it is."""
        ...


def requires_odometry(mapper: PoseEstimator) -> bool:
    """Return whether a mapper refuses scans without odometry; False where it does not say."""
    return bool(getattr(mapper, "requires_odometry", False))


def required_odometry(mapper: str, odometry: Pose2 | None, stamp: float) -> Pose2:
    """Return the odometry at a scan's stamp.

    Raises:
        ConfigError: there is none.
    """
    if odometry is None:
        raise ConfigError(f"{mapper} needs odometry, the scan at {stamp} s has none; hector maps without")
    return odometry


def parameters(name: str) -> tuple[str, ...]:
    """Return the names of a method's parameters, those of its configuration.

    Raises:
        ConfigError: no mapper has that name.
    """
    return tuple(_config_class(name).__dataclass_fields__)


def make_mapper(
    name: str, *, seed: int | None = None, resolution: float | None = None, **config: Any
) -> Mapper:
    """Make a mapper by its name; a `map` in cartographer's configuration makes it a Localizer as well.

    Args:
        name: one of MAPPERS.
        seed: of the random numbers, for a method that draws any.
        resolution: edge of the map's cell, metres, whatever the method calls it.
        **config: fields of the method's configuration.

    Raises:
        ConfigError: no mapper has that name, or its configuration no such field or not that value.
    """
    config_class = _config_class(name)
    method = MAPPERS[name]
    if seed is not None and "seed" in config_class.__dataclass_fields__:
        config["seed"] = seed
    if resolution is not None:
        config[method.resolution] = resolution
    for key in config:
        if key not in config_class.__dataclass_fields__:
            raise unknown_name(f"parameter of {name}", key, config_class.__dataclass_fields__)
    try:
        factory = getattr(importlib.import_module(method.module), method.factory)
        mapper: Mapper = factory(config_class(**config))
    except TypeError as error:
        raise ConfigError(f"configuration of {name}: {error}") from error
    return mapper


def _config_class(name: str) -> Any:
    """Return the class of a method's configuration.

    Raises:
        ConfigError: no mapper has that name.
    """
    if name not in MAPPERS:
        raise unknown_name("mapper", name, MAPPERS)
    method = MAPPERS[name]
    return getattr(importlib.import_module(method.module), method.config)
