"""What every SLAM method offers, and how to make one by its name."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory

# By name and not by import: one method must not drag in the others.
MAPPERS: Mapping[str, tuple[str, str, str]] = {
    "hector": ("slam_baselines.hector.mapper", "HectorConfig", "HectorMapper"),
    "gmapping": ("slam_baselines.gmapping.mapper", "GmappingConfig", "GmappingMapper"),
    "cartographer": ("slam_baselines.cartographer.mapper", "CartographerConfig", "make_cartographer"),
}
"""Name -> module, class of its configuration, what makes a mapper of one."""


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


class Mapper(Protocol):
    """Simultaneous localisation and mapping, one scan after the other.

    The map frame is the first base pose. Attitude and odometry help where they are given.
    """

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Take in a scan and return `T_map_base` at its stamp.

        Args:
            scan: as the sensor gave it.
            odometry: absolute `T_odom_base` at the scan's stamp, if there is odometry.
            imu: attitude at the scan's stamp, if there is one.
        """
        ...

    def map(self) -> OccupancyGrid:
        """Return the map in the map frame."""
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
        """Whether the mapper does not know at present where it is."""
        ...


def make_mapper(name: str, *, seed: int | None = None, **config: Any) -> Mapper:
    """Make a mapper by its name.

    Args:
        name: one of MAPPERS.
        seed: of the random numbers, for a method that draws any.
        **config: fields of the method's configuration.

    Raises:
        ConfigError: no mapper has that name, or its configuration no such field or not that value.
    """
    if name not in MAPPERS:
        raise unknown_name("mapper", name, MAPPERS)
    module, config_name, class_name = MAPPERS[name]
    method = importlib.import_module(module)
    config_class = getattr(method, config_name)
    if seed is not None and "seed" in config_class.__dataclass_fields__:
        config["seed"] = seed
    for key in config:
        if key not in config_class.__dataclass_fields__:
            raise unknown_name(f"parameter of {name}", key, config_class.__dataclass_fields__)
    try:
        mapper: Mapper = getattr(method, class_name)(config_class(**config))
    except TypeError as error:
        raise ConfigError(f"configuration of {name}: {error}") from error
    return mapper
