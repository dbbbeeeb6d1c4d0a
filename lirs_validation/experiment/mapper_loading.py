"""Mapper of a run by its name, and the Python interpreter that runs it."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from lirs_validation.experiment.own_code import keywords_taken, make_own, own_class, own_source_file
from lirs_wct.errors import ConfigError, unknown_name
from slam_baselines.mapper import (
    ALL_CLOUD_MAPPERS,
    CLOUD_MAPPERS,
    MAPPERS,
    CloudMapper,
    Mapper,
    make_cloud_mapper,
    make_mapper,
    read_parameters,
    reads_clouds,
)

RESOLUTION = 0.05
"""Edge of a map's cell for a mapper of your own that takes it, meters; ours use the same."""
PROBE = """
import sys, lirs_validation
from importlib.metadata import distributions
print(next((each.version for each in distributions(name=sys.argv[1])), ""))
"""
"""Program that prints the version of a package where lirs-wct is installed, else fails."""
PATIENCE = 60.0
"""Seconds within which an interpreter answers."""
METHODS, PROPERTIES = ("update", "map", "trajectory"), ("stats", "lost")
CLOUD_METHODS = ("update", "trajectory")


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
        mapper: name, or `module:name` of your own.
        given: path or name of an interpreter; None = this one.

    Raises:
        ConfigError: the given one cannot run this program, or lacks the mapper's package.
    """
    if given is None:
        return None
    python = shutil.which(str(Path(given).expanduser()))
    if python is None:
        raise ConfigError(f"{given}: no such program; --mapper-python takes a Python interpreter")
    method = CLOUD_MAPPERS.get(mapper)
    package = "lirs-wct" if method is None else method.distribution
    if not version_there(python, package) and method is not None:
        raise ConfigError(f"{given}: has no package {package}, which {mapper} needs")
    return python


def package_versions(mapper: str, given: str | None = None) -> dict[str, str]:
    """Return the versions of a mapper's own packages where it runs; empty for our methods."""
    method = CLOUD_MAPPERS.get(mapper)
    if method is None:
        return {}
    package, python = method.distribution, interpreter_of(mapper, given)
    here = next((each.version for each in distributions(name=package)), "")
    version = here if python is None else version_there(python, package)
    return {package: version} if version else {}


@cache
def version_there(python: str, package: str) -> str:
    """Return the version of a package in another interpreter; empty without it.

    Raises:
        ConfigError: lirs-wct is not installed there.
    """
    command = [python, "-P", "-c", PROBE, package]
    try:
        printed = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True).stdout
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise ConfigError(f"{python}: cannot import lirs_validation: install lirs-wct there") from error
    return printed.strip()
