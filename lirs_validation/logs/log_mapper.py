"""Mapper of a log, made by its config."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from lirs_validation.config import MapConfig
from lirs_validation.experiment.mapper_process import MapperProcess, needs_process
from lirs_validation.experiment.mapper_under_test import MapperUnderTest
from lirs_wct.errors import ConfigError, SourceError, unknown_name
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.sources.source import is_bag
from slam_baselines.mapper import (
    CLOUD_MAPPERS,
    MAPPERS,
    Mapper,
    make_mapper,
    parameters,
)
from slam_baselines.warm_up import warm_up

WARM_UP_CONFIG = {"gmapping": {"particles": 4}}
"""Kernels need no more particles than these to be compiled."""


@contextmanager
def log_mapper(config: MapConfig) -> Iterator[MapperUnderTest]:
    """Give the mapper of a log.

    Foreign code works in its own process, which ends with the block.

    Raises:
        ConfigError: there is no such mapper or parameter, or it reads point clouds and the log is no bag.
        MapperError: the process cannot be started.
    """
    with closing(_start(config)) as mapper:
        if mapper.reads_clouds and not is_bag(Path(config.log)):
            raise ConfigError(
                f"{config.log}: mapper {config.mapper} reads point clouds, a CARMEN log holds planar scans; "
                f"legal: {', '.join(MAPPERS)}"
            )
        yield mapper


def _start(config: MapConfig) -> MapperUnderTest:
    if not needs_process(config.mapper):
        return MapperUnderTest(partial(_make, config), config.mapper, config.attitude)
    _check_parameters(config)
    process = MapperProcess(config)
    process.wait_until_ready()
    return process


def _check_parameters(config: MapConfig) -> None:
    given = [name for name in ("particles", "resolution") if getattr(config, name) is not None]
    if given and config.mapper not in CLOUD_MAPPERS:
        raise ConfigError(f"{', '.join(given)} can be given for {', '.join(MAPPERS)} only")


def _make(config: MapConfig) -> Mapper:
    options = {"particles": config.particles, "resolution": config.resolution}
    given: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
    if config.mapper not in MAPPERS:
        raise unknown_name("mapper", config.mapper, [*MAPPERS, *CLOUD_MAPPERS, "module:name of your own"])
    if config.particles is not None and "particles" not in parameters(config.mapper):
        takers = ", ".join(name for name in MAPPERS if "particles" in parameters(name))
        raise ConfigError(f"{config.mapper} has no particles: --particles can be given for {takers}")
    return make_mapper(config.mapper, seed=config.seed, **given)


def check_log(config: MapConfig, mapper: MapperUnderTest, log: LaserLog) -> None:
    """Check that a log holds the data that the mapper needs.

    Raises:
        SourceError: nothing was seen in it, or it holds no odometry and the mapper needs it.
    """
    if mapper.reads_clouds:
        return
    if not any(scan.hits.any() for scan in log.scans):
        raise SourceError(f"{config.log}: none of its {len(log.scans)} scans met anything within range")
    if mapper.requires_odometry and log.odometry[0] is None:
        raise SourceError(
            f"{config.log}: holds no odometry (or one that never changes), {config.mapper} needs it; "
            "hector maps without"
        )


def warm_up_log_mapper(config: MapConfig) -> None:
    """Compile a mapper's kernels; one of your own is not warmed up."""
    if config.mapper in MAPPERS:
        warm_up(config.mapper, **WARM_UP_CONFIG.get(config.mapper, {}))
