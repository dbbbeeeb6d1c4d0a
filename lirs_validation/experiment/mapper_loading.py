"""The mapper of a run: one of ours by its name, or anybody's as `module:name`."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from lirs_validation.experiment.import_path import importable
from lirs_wct.errors import ConfigError, unknown_name
from slam_baselines.mapper import MAPPERS, Mapper, make_mapper
from slam_baselines.warm_up import warm_up

RESOLUTION = 0.05
"""Edge of a map's cell for a mapper of your own that takes it, metres; ours use the same."""
METHODS, PROPERTIES = ("update", "map", "trajectory"), ("stats", "lost")


def mapper_named(name: str, seed: int) -> Mapper:
    """Make a mapper by its name, or by `module:name` of a class (or function) that makes one.

    A class of your own gets `seed` and `resolution` as keywords where it takes them. Its module is looked
    for in the current folder too, which is on `sys.path` only while the module is imported.

    Raises:
        ConfigError: nothing has that name, it cannot be imported or made, or it is no mapper.
    """
    if ":" not in name:
        if name not in MAPPERS:
            raise unknown_name("mapper", name, [*MAPPERS, "module:name of your own"])
        return make_mapper(name, seed=seed)
    module_name, _, attribute = name.partition(":")
    maker = _attribute(_module(module_name, name), attribute, name)
    try:
        mapper = maker(**_taken(maker, {"seed": seed, "resolution": RESOLUTION}))
    except (ConfigError, KeyboardInterrupt):
        raise
    except BaseException as error:  # `sys.exit` too
        raise ConfigError(f"mapper {name!r}: cannot be made: {type(error).__name__}: {error}") from error
    return _checked(mapper, name)


def warm_up_mapper(name: str) -> None:
    """Compile a mapper's kernels; one of your own is only warmed up by driving."""
    if name in MAPPERS:
        warm_up(name)


def source_file(name: str) -> Path | None:
    """Return the file that holds a mapper of your own; None for ours."""
    if ":" not in name:
        return None
    file = getattr(_module(name.partition(":")[0], name), "__file__", None)
    return Path(file) if file else None


def _module(module: str, name: str) -> ModuleType:
    here = Path.cwd()
    try:
        with importable(here):
            return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is not None and (module == error.name or module.startswith(f"{error.name}.")):
            raise ConfigError(
                f"mapper {name!r}: no module {error.name!r} is installed or in {here}"
            ) from error
        raise ConfigError(
            f"mapper {name!r}: {module} imports {error.name!r}, which is not installed"
        ) from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # `sys.exit` too: a script without `if __name__ == "__main__"`
        raise ConfigError(
            f"mapper {name!r}: importing {module} failed: {type(error).__name__}: {error}"
        ) from error


def _attribute(module: ModuleType, attribute: str, name: str) -> Callable[..., Any]:
    found: Any = getattr(module, attribute, None)
    if callable(found):
        return found  # type: ignore[no-any-return]
    classes = {key: value for key, value in vars(module).items() if isinstance(value, type)}
    likely = sorted(key for key, value in classes.items() if hasattr(value, "update"))
    raise ConfigError(
        f"mapper {name!r}: {module.__name__} has no class {attribute!r}"
        f"; classes with update: {', '.join(likely) or 'none'}"
    )


def _taken(maker: Callable[..., Any], offered: dict[str, Any]) -> dict[str, Any]:
    """Return what of the offered keywords a maker takes."""
    try:
        parameters = inspect.signature(maker).parameters.values()
    except ValueError:  # some classes of compiled modules have no signature
        return {}
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters):
        return offered
    by_keyword = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    names = {p.name for p in parameters if p.kind in by_keyword}
    return {key: value for key, value in offered.items() if key in names}


def _checked(mapper: Any, name: str) -> Mapper:
    lacking = [f"{m}()" for m in METHODS if not callable(getattr(mapper, m, None))]
    lacking += [p for p in PROPERTIES if p not in dir(mapper)]
    if lacking:
        needed = ", ".join((*(f"{m}()" for m in METHODS), *PROPERTIES))
        raise ConfigError(f"mapper {name!r}: lacks {', '.join(lacking)}; a mapper has {needed}")
    checked: Mapper = mapper
    return checked
