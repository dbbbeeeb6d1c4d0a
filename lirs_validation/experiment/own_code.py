"""Loading of the user's own classes, named as `module:name` or `file.py:name`."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.machinery import PathFinder
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from lirs_wct.errors import ConfigError


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Put a folder first on `sys.path` in a block, unless it is there already."""
    entry = str(folder)
    if entry in sys.path:
        yield
        return
    sys.path.insert(0, entry)
    try:
        yield
    finally:
        with suppress(ValueError):
            sys.path.remove(entry)


def own_class(name: str, what: str, method: str) -> Callable[..., Any]:
    """Return the class or function that `module:name` or `file.py:name` names.

    A module is looked for in the current folder too, which is on `sys.path` only while it is imported.

    Args:
        name: `module:name` or `file.py:name`.
        what: kind of the made object, such as "mapper".
        method: method of the made object; if the name is unknown, the error lists classes with it.

    Raises:
        ConfigError: the module cannot be imported, or has nothing of that name that can be called.
    """
    module_name, _, attribute = name.rpartition(":")
    module = _module(module_name, name, what)
    found: Any = getattr(module, attribute, None)
    if callable(found):
        return found  # type: ignore[no-any-return]
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
    """Return the file of the module in `module:name`; None = a built-in name."""
    if ":" not in name:
        return None
    folders, found = [str(Path.cwd()), *sys.path], None
    if (file := name.rpartition(":")[0]).endswith(".py"):
        return Path(file)
    for part in name.partition(":")[0].split("."):
        found = PathFinder.find_spec(part, folders)
        if found is None:
            return None
        folders = list(found.submodule_search_locations or ())
    return Path(found.origin) if found is not None and found.origin else None


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


def _module(module: str, name: str, what: str) -> ModuleType:
    here = Path.cwd()
    try:
        if module.endswith(".py"):
            return _module_of_file(Path(module))
        with importable(here):
            return importlib.import_module(module)
    except FileNotFoundError as error:
        raise ConfigError(f"{what} {name!r}: {module}: no such file") from error
    except ModuleNotFoundError as error:
        if error.name is not None and (module == error.name or module.startswith(f"{error.name}.")):
            raise ConfigError(
                f"{what} {name!r}: no module {error.name!r} is installed or in {here}"
            ) from error
        raise ConfigError(
            f"{what} {name!r}: {module} imports {error.name!r}, which is not installed"
        ) from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # `sys.exit` too: a script without `if __name__ == "__main__"`
        raise ConfigError(
            f"{what} {name!r}: importing {module} failed: {type(error).__name__}: {error}"
        ) from error
