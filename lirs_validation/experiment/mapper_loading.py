"""Mapper of a run by its name, and the Python interpreter that runs it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from importlib.machinery import PathFinder
from importlib.metadata import distributions
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lirs_validation.experiment.own_code import keywords_taken, make_own, own_class, own_source_file
from lirs_wct.errors import ConfigError, unknown_name
from slam_baselines.mapper import (
    ALL_CLOUD_MAPPERS,
    CLOUD_MAPPERS,
    MAPPERS,
    CloudMapper,
    Mapper,
    Method,
    make_cloud_mapper,
    make_mapper,
    read_parameters,
    reads_clouds,
)

if TYPE_CHECKING:  # another interpreter loads no options
    from lirs_validation.config import Attitude

RESOLUTION = 0.05
"""Edge of a map's cell for a mapper of your own that takes it, meters; ours use the same."""
OLDEST = (3, 11)
PROBE = "import json, sys; print(json.dumps([sys.version_info[:2], [entry for entry in sys.path if entry]]))"
PATIENCE = 60.0
"""Seconds within which an interpreter answers."""
METHODS, PROPERTIES = ("update", "map", "trajectory"), ("stats", "lost")
CLOUD_METHODS = ("update", "trajectory")


@dataclass(frozen=True, slots=True)
class MapperSpec:
    """Specification of a mapper.

    Attributes:
        mapper: its name, or `module:name`.
        seed: of its random numbers.
        attitude: `imu`, or `none` for a mapper without inertial readings.
        parameters: fields of its configuration (`NAME=VALUE,...`).
    """

    mapper: str
    seed: int
    attitude: Attitude
    parameters: str = ""


def mapper_named(name: str, seed: int, parameters: str = "") -> Mapper | CloudMapper:
    """Create a mapper by its name, or by a `module:name`.

    The latter names a class or function that makes one.

    A class of your own gets `seed` and `resolution` as keywords where it takes them. Its module is looked
    for in the current folder too, which is on `sys.path` only while the module is imported.

    Raises:
        ConfigError: nothing has that name, it cannot be imported or made, a package is missing, or
            it is no mapper.
    """
    given = read_parameters(parameters)
    if name in ALL_CLOUD_MAPPERS:
        return make_cloud_mapper(name, seed=seed, **given)
    if ":" not in name:
        if name not in MAPPERS:
            raise unknown_name("mapper", name, [*MAPPERS, *ALL_CLOUD_MAPPERS, "module:name of your own"])
        return make_mapper(name, seed=seed, **given)
    if name.startswith("evalio:"):
        raise unknown_name("mapper", name, [each for each in ALL_CLOUD_MAPPERS if each.startswith("evalio:")])
    maker = own_class(name, "mapper", "update")
    for key in set(given) - set(keywords_taken(maker, given)):
        raise ConfigError(f"mapper {name!r} takes no parameter {key!r}")
    mapper = make_own(maker, {"seed": seed, "resolution": RESOLUTION} | given, name, "mapper")
    return _check_methods(mapper, name)


def warm_up_mapper(name: str) -> None:
    """Compile a mapper's kernels; one of your own is only warmed up by driving."""
    if name in MAPPERS:
        from slam_baselines.warm_up import warm_up

        warm_up(name)


def source_file(name: str) -> Path | None:
    """Return the file that holds a mapper of your own; None for ours."""
    return None if name in ALL_CLOUD_MAPPERS else own_source_file(name)


def _check_methods(mapper: Any, name: str) -> Mapper | CloudMapper:
    methods = CLOUD_METHODS if reads_clouds(mapper) else METHODS
    lacking = [f"{m}()" for m in methods if not callable(getattr(mapper, m, None))]
    lacking += [p for p in PROPERTIES if p not in dir(mapper)]
    if lacking:
        needed = ", ".join((*(f"{m}()" for m in methods), *PROPERTIES))
        raise ConfigError(f"mapper {name!r}: lacks {', '.join(lacking)}; a mapper has {needed}")
    checked: Mapper | CloudMapper = mapper
    return checked


def interpreter_of(mapper: str, given: str | None = None) -> str | None:
    """Return the interpreter that runs a third-party mapper; None = this one.

    Args:
        mapper: its name, or `module:name` of your own.
        given: path or name of an interpreter; None = this one.

    Raises:
        ConfigError: the given one cannot be used, or lacks the mapper's package.
    """
    method = CLOUD_MAPPERS.get(mapper)
    if given is None:
        return None
    python = _usable(given)
    if method is not None and not _holds(python, method):
        raise ConfigError(f"{given}: has no package {method.distribution}, which {mapper} needs")
    return python


def package_versions(mapper: str, given: str | None = None) -> dict[str, str]:
    """Return the versions of a mapper's own packages where it runs; empty for our methods."""
    method = CLOUD_MAPPERS.get(mapper)
    if method is None:
        return {}
    python = interpreter_of(mapper, given)
    path = sys.path if python is None else search_path(python)
    found = next(iter(distributions(name=method.distribution, path=list(path))), None)
    return {} if found is None else {method.distribution: found.version}


@cache
def search_path(python: str) -> tuple[str, ...]:
    """Return the folders in which an interpreter looks for modules.

    Raises:
        ConfigError: it does not run, or is too old.
    """
    try:
        told = subprocess.run([python, "-c", PROBE], capture_output=True, timeout=PATIENCE, check=True)
        version, path = json.loads(told.stdout)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise ConfigError(f"{python}: is no Python interpreter that runs") from error
    if tuple(version) < OLDEST:
        oldest, given = (".".join(map(str, numbers)) for numbers in (OLDEST, version))
        raise ConfigError(f"{python}: a mapper's interpreter must be Python {oldest} or newer, got {given}")
    return tuple(path)


def _usable(given: str) -> str:
    """Return the path of an interpreter that can run our part of a mapper's process."""
    python = shutil.which(str(Path(given).expanduser()))
    if python is None:
        raise ConfigError(f"{given}: no such program; --mapper-python takes a Python interpreter")
    if PathFinder.find_spec("numpy", list(search_path(python))) is None:
        raise ConfigError(f"{given}: has no NumPy, which a mapper's process needs")
    return python


def _holds(python: str, method: Method) -> bool:
    return PathFinder.find_spec(method.package, list(search_path(python))) is not None
