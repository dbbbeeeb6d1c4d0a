"""Mapper of a run: a built-in name, or `module:name` of your own."""

from __future__ import annotations

import importlib.metadata
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lirs_validation.config import Attitude
from lirs_validation.experiment.own_code import make_own, own_class, own_source_file
from lirs_wct.errors import ConfigError, unknown_name
from slam_baselines.mapper import (
    CLOUD_MAPPERS,
    MAPPERS,
    CloudMapper,
    Mapper,
    make_cloud_mapper,
    make_mapper,
    reads_clouds,
)
from slam_baselines.warm_up import warm_up

RESOLUTION = 0.05
"""Edge of a map's cell for a mapper of your own that takes it, meters; ours use the same."""
METHODS, PROPERTIES = ("update", "map", "trajectory"), ("stats", "lost")
CLOUD_METHODS = ("update", "trajectory")


@dataclass(frozen=True, slots=True)
class MapperSpec:
    """Specification of a mapper.

    Attributes:
        mapper: its name, or `module:name`.
        seed: of its random numbers.
        attitude: `imu`, or `none` for a mapper without inertial readings.
    """

    mapper: str
    seed: int
    attitude: Attitude


def mapper_named(name: str, seed: int) -> Mapper | CloudMapper:
    """Create a mapper by its name, or by a `module:name`.

    The latter names a class or function that makes one.

    A class of your own gets `seed` and `resolution` as keywords where it takes them. Its module is looked
    for in the current folder too, which is on `sys.path` only while the module is imported.

    Raises:
        ConfigError: nothing has that name, it cannot be imported or made, a package is missing, or
            it is no mapper.
    """
    if name in CLOUD_MAPPERS:
        return make_cloud_mapper(name, seed=seed)
    if ":" not in name:
        if name not in MAPPERS:
            raise unknown_name("mapper", name, [*MAPPERS, *CLOUD_MAPPERS, "module:name of your own"])
        return make_mapper(name, seed=seed)
    maker = own_class(name, "mapper", "update")
    mapper = make_own(maker, {"seed": seed, "resolution": RESOLUTION}, name, "mapper")
    return _check_methods(mapper, name)


def package_versions(name: str) -> dict[str, str]:
    """Return the versions of a mapper's own packages; empty for our methods."""
    method = CLOUD_MAPPERS.get(name)
    if method is None or not method.installed:
        return {}
    return {method.distribution: importlib.metadata.version(method.distribution)}


def warm_up_mapper(name: str) -> None:
    """Compile a mapper's kernels; one of your own is only warmed up by driving."""
    if name in MAPPERS:
        warm_up(name)


def source_file(name: str) -> Path | None:
    """Return the file that holds a mapper of your own; None for ours."""
    return own_source_file(name)


def _check_methods(mapper: Any, name: str) -> Mapper | CloudMapper:
    methods = CLOUD_METHODS if reads_clouds(mapper) else METHODS
    lacking = [f"{m}()" for m in methods if not callable(getattr(mapper, m, None))]
    lacking += [p for p in PROPERTIES if p not in dir(mapper)]
    if lacking:
        needed = ", ".join((*(f"{m}()" for m in methods), *PROPERTIES))
        raise ConfigError(f"mapper {name!r}: lacks {', '.join(lacking)}; a mapper has {needed}")
    checked: Mapper | CloudMapper = mapper
    return checked
