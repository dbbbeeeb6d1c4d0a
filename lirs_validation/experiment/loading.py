"""Mappers by name, the user's own classes, and the Python interpreter that runs a third-party mapper."""

from __future__ import annotations

import importlib
import inspect
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.machinery import PathFinder
from importlib.metadata import distributions
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from lirs_validation.processes import importable
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
METHODS, PROPERTIES = ("update", "map", "trajectory"), ("stats", "lost")
CLOUD_METHODS = ("update", "trajectory")


def mapper_named(name: str, seed: int, parameters: str = "") -> Mapper | CloudMapper:
    """Create a mapper by its name, or by `module:name` of a class or function that makes one.

    A class of your own gets `seed` and `resolution` as keywords where it takes them.

    Raises:
        ConfigError: nothing has that name, it cannot be imported or made, a package is missing, or
            it is no mapper.
    """
    options = read_parameters(parameters)
    if name in ALL_CLOUD_MAPPERS:
        return make_cloud_mapper(name, seed=seed, **options)
    if ":" not in name:
        if name not in MAPPERS:
            raise unknown_name("mapper", name, [*MAPPERS, *ALL_CLOUD_MAPPERS, "module:name of your own"])
        return make_mapper(name, seed=seed, **options)
    if name.startswith("evalio:"):
        raise unknown_name("mapper", name, [each for each in ALL_CLOUD_MAPPERS if each.startswith("evalio:")])
    maker = own_class(name, "mapper", "update")
    for key in set(options) - set(keywords_taken(maker, options)):
        raise ConfigError(f"mapper {name!r} takes no parameter {key!r}")
    mapper: Any = make_own(maker, {"seed": seed, "resolution": RESOLUTION} | options, name, "mapper")
    methods = CLOUD_METHODS if reads_clouds(mapper) else METHODS
    lacking = [f"{m}()" for m in methods if not callable(getattr(mapper, m, None))]
    lacking += [p for p in PROPERTIES if p not in dir(mapper)]
    if lacking:
        needed = ", ".join((*(f"{m}()" for m in methods), *PROPERTIES))
        raise ConfigError(f"mapper {name!r}: lacks {', '.join(lacking)}; a mapper has {needed}")
    own: Mapper | CloudMapper = mapper
    return own


def own_class(name: str, what: str, method: str) -> Callable[..., Any]:
    """Return the class or function that `module:name` or `file.py:name` names.

    A module is looked for in the current folder too, which is on `sys.path` only while it is imported.

    Args:
        name: `module:name` or `file.py:name`.
        what: Kind of the made object, such as "mapper".
        method: Method of the made object; if the name is unknown, the error lists classes with it.

    Raises:
        ConfigError: the module cannot be imported, or has nothing of that name that can be called.
    """
    module_name, _, attribute = name.rpartition(":")
    module = _module(module_name, f"{what} {name!r}")
    maker: Any = getattr(module, attribute, None)
    if callable(maker):
        return maker  # type: ignore[no-any-return]
    classes = {key: value for key, value in vars(module).items() if isinstance(value, type)}
    likely = sorted(key for key, value in classes.items() if hasattr(value, method))
    raise ConfigError(
        f"{what} {name!r}: {module.__name__} has no class {attribute!r}"
        f"; classes with {method}: {', '.join(likely) or 'none'}"
    )


def make_own(maker: Callable[..., Any], offered: Mapping[str, Any], name: str, what: str) -> Any:
    """Call a maker with those of the offered keywords that it takes.

    Raises:
        ConfigError: it raised, or ended the program.
    """
    try:
        return maker(**keywords_taken(maker, offered))
    except (ConfigError, KeyboardInterrupt):
        raise
    except BaseException as error:  # `sys.exit` too
        raise ConfigError(f"{what} {name!r}: cannot be made: {type(error).__name__}: {error}") from error


def own_source_file(name: str) -> Path | None:
    """Return the file of a user's class, `module:name` or `file.py:name`; None for built-in names."""
    if ":" not in name or name in ALL_CLOUD_MAPPERS:
        return None
    module, spec = name.rpartition(":")[0], None
    if module.endswith(".py"):
        return Path(module)
    folders = [str(Path.cwd()), *sys.path]
    for part in name.partition(":")[0].split("."):
        spec = PathFinder.find_spec(part, folders)
        if spec is None:
            return None
        folders = list(spec.submodule_search_locations or ())
    return Path(spec.origin) if spec is not None and spec.origin else None


def keywords_taken(maker: Callable[..., Any], offered: Mapping[str, Any]) -> dict[str, Any]:
    """Return the offered keywords that a maker accepts."""
    try:
        parameters = inspect.signature(maker).parameters.values()
    except ValueError:  # some classes of compiled modules have no signature
        return {}
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters):
        return dict(offered)
    by_keyword = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    names = {p.name for p in parameters if p.kind in by_keyword}
    return {key: value for key, value in offered.items() if key in names}


def _module(module: str, named: str) -> ModuleType:
    """Import a module or a file for an object that messages call by `named`."""
    here = Path.cwd()
    try:
        if module.endswith(".py"):
            return _module_of_file(Path(module))
        with importable(here):
            return importlib.import_module(module)
    except KeyboardInterrupt:
        raise
    except FileNotFoundError as error:
        raise ConfigError(f"{named}: {module}: no such file") from error
    except ModuleNotFoundError as error:
        if error.name is not None and (module == error.name or module.startswith(f"{error.name}.")):
            raise ConfigError(f"{named}: no module {error.name!r} is installed or in {here}") from error
        raise ConfigError(f"{named}: {module} imports {error.name!r}, which is not installed") from error
    except BaseException as error:  # `sys.exit` too: a script without `if __name__ == "__main__"`
        raise ConfigError(f"{named}: importing {module} failed: {type(error).__name__}: {error}") from error


def _module_of_file(file: Path) -> ModuleType:
    """Import a file under its stem; it may import its neighbors."""
    spec = spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    if file.stem in sys.stdlib_module_names:
        raise ImportError(f"{file.stem} is a module of Python, the file needs another name")
    sys.path.append(str(file.resolve().parent))  # also for processes that a mapper spawns
    module = sys.modules[file.stem] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PROBE = """
import sys, lirs_validation
from importlib.metadata import distributions
print(next((each.version for each in distributions(name=sys.argv[1])), ""))
"""
"""Program that prints the version of a package where lirs-wct is installed, else fails."""
PATIENCE = 60.0
"""Seconds within which an interpreter answers."""


def interpreter_of(mapper: str, interpreter: str | None = None) -> str | None:
    """Return the interpreter that runs a third-party mapper; None = this one.

    Args:
        mapper: Name, or `module:name` of your own.
        interpreter: Path or name of an interpreter; None = this one.

    Raises:
        ConfigError: the interpreter cannot run this program, or lacks the mapper's package.
    """
    if interpreter is None:
        return None
    python = shutil.which(str(Path(interpreter).expanduser()))
    if python is None:
        raise ConfigError(f"{interpreter}: no such program; --mapper-python takes a Python interpreter")
    method = CLOUD_MAPPERS.get(mapper)
    package = "lirs-wct" if method is None else method.distribution
    if not _version_there(python, package) and method is not None:
        raise ConfigError(f"{interpreter}: has no package {package}, which {mapper} needs")
    return python


def package_versions(mapper: str, interpreter: str | None = None) -> dict[str, str]:
    """Return the versions of a mapper's own packages where it runs; empty for our methods."""
    method = CLOUD_MAPPERS.get(mapper)
    if method is None:
        return {}
    package, python = method.distribution, interpreter_of(mapper, interpreter)
    here = next((each.version for each in distributions(name=package)), "")
    version = here if python is None else _version_there(python, package)
    return {package: version} if version else {}


@cache
def _version_there(python: str, package: str) -> str:
    """Return the version of a package in another interpreter; empty without it."""
    command = [python, "-P", "-c", PROBE, package]
    try:
        printed = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True).stdout
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise ConfigError(f"{python}: cannot import lirs_validation: install lirs-wct there") from error
    return printed.strip()
