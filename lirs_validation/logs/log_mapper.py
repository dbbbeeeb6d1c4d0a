"""Mapper of a log, made by its config."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from lirs_validation.config import MapConfig
from lirs_validation.experiment.feeding.process import MapperProcess, needs_process
from lirs_validation.experiment.mapper_guard import GuardedCloudMapper, GuardedMapper, guard_mapper
from lirs_wct.errors import ConfigError, SourceError, unknown_name
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.sources.source import is_bag
from slam_baselines.mapper import (
    CLOUD_MAPPERS,
    MAPPERS,
    Mapper,
    make_mapper,
    parameters,
    reads_clouds,
    requires_odometry,
)
from slam_baselines.warm_up import warm_up

WARM_UP_CONFIG = {"gmapping": {"particles": 4}}
"""Kernels need no more particles than these to be compiled."""


@contextmanager
def log_mapper(config: MapConfig) -> Iterator[GuardedMapper | GuardedCloudMapper]:
    """Give the guarded mapper of a log; foreign code works in its own process, which ends with the block.

    Raises:
        ConfigError: there is no such mapper or parameter, or it reads point clouds and the log is no bag.
        MapperError: the process cannot be started.
    """
    with ExitStack() as started:
        if needs_process(config.mapper):
            _check_parameters(config)
            made: Any = MapperProcess(config, concurrent=False)
            started.callback(made.close)
            made.wait_until_ready()
        else:
            made = _make(config)
        if reads_clouds(made) and not is_bag(Path(config.log)):
            raise ConfigError(
                f"{config.log}: mapper {config.mapper} reads point clouds, a CARMEN log holds planar scans; "
                f"legal: {', '.join(MAPPERS)}"
            )
        yield guard_mapper(made, config)


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
