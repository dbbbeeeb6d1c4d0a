"""The user's own classes, and the Python interpreter that runs a third-party mapper."""

from __future__ import annotations

import importlib
import inspect
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from lirs_validation.processes import importable
from lirs_validation.record.run_record import code
from lirs_wct.errors import ConfigError, unknown_name
from slam_baselines.mapper import ALL_CLOUD_MAPPERS, CLOUD_MAPPERS, CloudMapper, Mapper, reads_clouds

RESOLUTION = 0.05
"""Edge of a map's cell for a mapper of your own that takes it, meters; ours use the same."""
METHODS, PROPERTIES = ("update", "map", "trajectory"), ("stats", "lost")
CLOUD_METHODS = ("update", "trajectory")


def own_mapper(name: str, seed: int, options: Mapping[str, Any]) -> Mapper | CloudMapper:
    """Create a mapper by `module:name` of a class or function that makes one.

    It gets `seed` and `resolution` as keywords where it takes them.
    """
    if name.startswith("evalio:"):
        raise unknown_name("mapper", name, [each for each in ALL_CLOUD_MAPPERS if each.startswith("evalio:")])
    offered = {"seed": seed, "resolution": RESOLUTION}
    mapper: Mapper | CloudMapper = make_own(name, "mapper", "update", offered, options)
    check_members(mapper, name, "mapper", CLOUD_METHODS if reads_clouds(mapper) else METHODS, PROPERTIES)
    return mapper


def own_class(name: str, what: str, method: str) -> Callable[..., Any]:
    """Return the class or function that `module:name` or `file.py:name` names.

    A module is looked for in the current folder too, which is on `sys.path` only while it is imported. An
    error about an unknown name lists classes with the method.
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


def make_own(name: str, what: str, method: str, offered: Mapping[str, Any], given: Mapping[str, Any]) -> Any:
    """Make an object of a user's class (see `own_class`).

    It gets the given keywords, and those of the offered ones that it takes.
    """
    maker = own_class(name, what, method)
    try:
        parameters = list(inspect.signature(maker).parameters.values())
    except ValueError:  # some classes of compiled modules have no signature
        parameters = []
    names = [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        names += [*offered, *given]
    for key in set(given) - set(names):
        raise ConfigError(
            f"{what} {name!r} takes no parameter {key!r}; it takes {', '.join(names) or 'none'}"
        )
    keywords = {key: value for key, value in {**offered, **given}.items() if key in names}
    try:
        return maker(**keywords)
    except (ConfigError, KeyboardInterrupt):
        raise
    except BaseException as error:  # `sys.exit` too
        raise ConfigError(f"{what} {name!r}: cannot be made: {type(error).__name__}: {error}") from error


def check_members(
    made: object, name: str, what: str, methods: tuple[str, ...], properties: tuple[str, ...] = ()
) -> None:
    """Check that an object of a user's class has its methods and properties."""
    lacking = [f"{method}()" for method in methods if not callable(getattr(made, method, None))]
    lacking += [name for name in properties if name not in dir(made)]
    if lacking:
        needed = ", ".join((*(f"{method}()" for method in methods), *properties))
        raise ConfigError(f"{what} {name!r}: lacks {', '.join(lacking)}; a {what} has {needed}")


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
import sys
from importlib.metadata import distributions
from lirs_validation.record.run_record import code
print(code(), next((each.version for each in distributions(name=sys.argv[1])), ""))
"""
"""Program that prints the code of lirs-wct, where it is installed, and the version of a package."""
PATIENCE = 60.0
"""Seconds within which an interpreter answers."""


def interpreter_of(mapper: str, interpreter: str) -> str:
    """Return the path of the interpreter that runs a mapper."""
    python = shutil.which(str(Path(interpreter).expanduser()))
    if python is None:
        raise ConfigError(f"{interpreter}: no such program; --mapper-python takes a Python interpreter")
    method = CLOUD_MAPPERS.get(mapper)
    package = "lirs-wct" if method is None else method.distribution
    there, version = versions_there(python, package)
    if there != code():
        raise ConfigError(
            f"{interpreter}: lirs-wct must have code {code()}, got {there}; install this one there"
        )
    if not version and method is not None:
        raise ConfigError(f"{interpreter}: has no package {package}, which {mapper} needs")
    return python


@cache
def versions_there(python: str, package: str) -> tuple[str, str]:
    """Return the code of lirs-wct and the version of a package, empty without it, in another interpreter."""
    command = [python, "-P", "-c", PROBE, package]
    try:
        printed = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True).stdout
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise ConfigError(f"{python}: cannot import lirs_validation: install lirs-wct there") from error
    there, _, version = printed.strip().partition(" ")
    return there, version
