"""The mapper that a log is mapped with: made by its config, and its kernels compiled."""

from __future__ import annotations

from typing import Any

from lirs_validation.map_record import MapConfig
from lirs_validation.mappers import mapper_named
from lirs_wct.errors import ConfigError
from slam_baselines.mapper import MAPPERS, Mapper, make_mapper
from slam_baselines.rehearsal import rehearse

RESOLUTION = {"hector": "map_resolution", "gmapping": "delta", "cartographer": "map_resolution"}
"""What each mapper calls the edge of its map's cell."""
REHEARSED = {"gmapping": {"particles": 4}}
"""Kernels need no more particles than these to be compiled."""


def make_log_mapper(config: MapConfig) -> Mapper:
    """Make the mapper; a parameter that it does not have is refused.

    Raises:
        ConfigError: there is no such mapper, or it has no such parameter.
    """
    given: dict[str, Any] = {}
    if config.particles is not None:
        given["particles"] = config.particles
    if config.resolution is not None:
        given[RESOLUTION.get(config.mapper, "resolution")] = config.resolution
    if config.mapper in MAPPERS:
        return make_mapper(config.mapper, seed=config.seed, **given)
    if given:
        raise ConfigError(f"{', '.join(given)} can be given for {', '.join(MAPPERS)} only")
    return mapper_named(config.mapper, config.seed)


def rehearse_log_mapper(config: MapConfig) -> None:
    """Compile a mapper's kernels; one of your own is not rehearsed."""
    if config.mapper in MAPPERS:
        rehearse(config.mapper, **REHEARSED.get(config.mapper, {}))
