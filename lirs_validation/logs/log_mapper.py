"""Mapper of a log: creation by its config, compilation of kernels."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from lirs_validation.config import MapConfig
from lirs_validation.experiment.mapper_guard import GuardedCloudMapper, GuardedMapper, with_attitude
from lirs_validation.experiment.mapper_loading import mapper_named
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.sources.source import is_bag
from slam_baselines.mapper import (
    CLOUD_MAPPERS,
    MAPPERS,
    CloudMapper,
    Mapper,
    make_mapper,
    parameters,
    reads_clouds,
    requires_odometry,
)
from slam_baselines.warm_up import warm_up

WARM_UP_CONFIG = {"gmapping": {"particles": 4}}
"""Kernels need no more particles than these to be compiled."""


def make_log_mapper(config: MapConfig) -> GuardedMapper | GuardedCloudMapper:
    """Make the mapper behind its guard; a parameter that it does not have is refused.

    Raises:
        ConfigError: there is no such mapper, or it has no such parameter, or it reads point clouds and the
            log is no bag.
    """
    mapper = _make(config)
    if not reads_clouds(mapper):
        return GuardedMapper(with_attitude(cast("Mapper", mapper), config.attitude), config.mapper)
    if not is_bag(Path(config.log)):
        raise ConfigError(
            f"{config.log}: mapper {config.mapper} reads point clouds, a CARMEN log holds planar scans; "
            f"legal: {', '.join(MAPPERS)}"
        )
    return GuardedCloudMapper(mapper, config.mapper, attitude=config.attitude == "imu")


def _make(config: MapConfig) -> Mapper | CloudMapper:
    given: dict[str, Any] = {}
    if config.particles is not None:
        given["particles"] = config.particles
    if config.resolution is not None:
        given["resolution"] = config.resolution
    if config.mapper in MAPPERS:
        if config.particles is not None and "particles" not in parameters(config.mapper):
            takers = ", ".join(name for name in MAPPERS if "particles" in parameters(name))
            raise ConfigError(f"{config.mapper} has no particles: --particles can be given for {takers}")
        return make_mapper(config.mapper, seed=config.seed, **given)
    if given and config.mapper not in CLOUD_MAPPERS:
        raise ConfigError(f"{', '.join(given)} can be given for {', '.join(MAPPERS)} only")
    return mapper_named(config.mapper, config.seed)


def check_log(config: MapConfig, mapper: GuardedMapper | GuardedCloudMapper, log: LaserLog) -> None:
    """Check that a log holds the data that the mapper needs.

    Raises:
        SourceError: nothing was seen in it, or it holds no odometry and the mapper needs it.
    """
    if isinstance(mapper, GuardedCloudMapper):
        return
    if not any(scan.hits.any() for scan in log.scans):
        raise SourceError(f"{config.log}: none of its {len(log.scans)} scans met anything within range")
    if requires_odometry(mapper) and log.odometry[0] is None:
        raise SourceError(
            f"{config.log}: holds no odometry (or one that never changes), {config.mapper} needs it; "
            "hector maps without"
        )


def warm_up_log_mapper(config: MapConfig) -> None:
    """Compile a mapper's kernels; one of your own is not warmed up."""
    if config.mapper in MAPPERS:
        warm_up(config.mapper, **WARM_UP_CONFIG.get(config.mapper, {}))
