"""The options of `build`, which every command that takes a source takes too; made from their declarations."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from functools import wraps
from typing import Annotated, Any, Literal, TypeVar, get_type_hints

import typer

from lirs_validation.cli.log_sources import with_logs_mapped
from lirs_validation.config import SourceOptions
from lirs_wct.contact.contact_geometry import CONTACT_GEOMETRIES, ContactGeometry
from lirs_wct.option import Option, Options, declared
from lirs_wct.sources.option_text import chosen

Given = TypeVar("Given", bound=Options)
_SWITCH = "_switch"
"""Ends the names of parameters that are switches."""


def gazebo_terrain(given: str) -> Literal["solid", "heightmap"]:
    """Return what Gazebo's model is to be.

    Raises:
        ConfigError: it is neither.
    """
    terrain: Literal["solid", "heightmap"] = chosen(given, "--terrain", ("solid", "heightmap"))
    return terrain


def mujoco_terrain(given: str) -> ContactGeometry:
    """Return what MuJoCo is to touch.

    Raises:
        ConfigError: it is none of these.
    """
    terrain: ContactGeometry = chosen(given, "--terrain", CONTACT_GEOMETRIES)
    return terrain


def with_build_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options that the class of its last parameter, `options`, declares.

    Logs among its sources are mapped before it sees them.
    """
    own = inspect.signature(command, eval_str=True)
    kind: type[SourceOptions] = own.parameters["options"].annotation
    parameters = [p for p in own.parameters.values() if p.name != "options"]
    shared = list(_parameters(kind, taken={f"--{p.name}" for p in parameters}))

    @wraps(command)
    def wrapped(**given: Any) -> Any:
        said = {p.name: given.pop(p.name) for p in shared}
        given, options = with_logs_mapped(given, read_options(kind, said))
        return command(**given, options=options)

    keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in (*parameters, *shared)]
    wrapped.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    wrapped.__annotations__ = {p.name: p.annotation for p in keywords}
    del wrapped.__wrapped__
    return wrapped


def typer_option(options: type[Options], name: str) -> Any:
    """Return the declaration of one option, for a command that takes no other."""
    declaration = dict(declared(options))[name]
    return _typer(declaration, declaration.flags)


def read_options(kind: type[Given], said: dict[str, Any]) -> Given:
    """Return the options of what was said at the command line.

    Args:
        kind: class of options.
        said: value of each of its parameters, switches included.

    Raises:
        ConfigError: a value is not legal, or two options contradict.
    """
    return kind(**{name: _value(option, name, said) for name, option in declared(kind)})


def _value(option: Option, name: str, said: dict[str, Any]) -> Any:
    value = said[name]
    if option.read is not None:
        value = option.read(value, option.flags[0]) if value else None
    if value is None and option.switch is not None and said[name + _SWITCH]:
        return option.switch.value
    return value


def _parameters(kind: type[Options], taken: set[str]) -> Iterator[inspect.Parameter]:
    """Yield the parameters of a class of options; flags that the command has itself stay the command's."""
    types = get_type_hints(kind)
    default = kind()
    for name, option in declared(kind):
        if option.switch is not None:
            flag = typer.Option(option.switch.flag, help=option.switch.help, rich_help_panel=option.panel)
            yield _keyword(name + _SWITCH, False, Annotated[bool, flag])
        flags = tuple(flag for flag in option.flags if flag not in taken)
        value = getattr(default, name)
        written = types[name] if option.read is None else str if value is not None else str | None
        yield _keyword(name, value, Annotated[written, _typer(option, flags)])


def _typer(option: Option, flags: tuple[str, ...]) -> Any:
    return typer.Option(*flags, metavar=option.metavar, help=option.help, rich_help_panel=option.panel)


def _keyword(name: str, default: Any, annotation: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
