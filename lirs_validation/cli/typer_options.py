"""Shared arguments of commands, and options generated from the declarations of option classes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import typer

from lirs_validation.cli.progress import err, progress_bar
from lirs_validation.config import SourceOptions
from lirs_wct.contact.contact_geometry import CONTACT_GEOMETRIES, ContactGeometry
from lirs_wct.errors import ConfigError
from lirs_wct.option import Option, Options, chosen, declared, defaults

SOURCE_HELP = "simple, medium, advanced, a picture, a map YAML, a laser log, a mesh or a built folder."


def complete_source(incomplete: str) -> list[str]:
    """Return bundled worlds and paths that begin with a text, for the shell."""
    # Slow to import; only the shell's completion needs it.
    from lirs_wct.sources.bundled import RECIPES

    worlds = [name for name in RECIPES if name.startswith(incomplete)]
    folder, separator, name = incomplete.rpartition("/")
    found = [path.name for path in Path(folder + separator).glob("*") if path.name.startswith(name)]
    return worlds + sorted(folder + separator + name for name in found)


Sources = Annotated[list[str], typer.Argument(help=SOURCE_HELP, autocompletion=complete_source)]
Source = Annotated[str, typer.Argument(help=SOURCE_HELP, autocompletion=complete_source)]


def read_fields(text: str | None, flag: str) -> dict[str, str]:
    """Return the fields and values of a list such as `mapper=hector,world=medium`; nothing of None.

    Raises:
        ConfigError: it is no such list.
    """
    pairs = [part.partition("=") for part in (text.split(",") if text is not None else ())]
    if not all(name.strip() and value.strip() for name, _, value in pairs):
        raise ConfigError(f"{flag} must be a list such as mapper=hector,world=medium, got {text!r}")
    return {name.strip(): value.strip() for name, _, value in pairs}


_SWITCH = "_switch"
"""Suffix of the names of parameters that are switches."""


def gazebo_terrain(given: str) -> Literal["solid", "heightmap"]:
    """Return the kind of terrain of a Gazebo model.

    Raises:
        ConfigError: it is neither `solid` nor `heightmap`.
    """
    terrain: Literal["solid", "heightmap"] = chosen(given, "--terrain", ("solid", "heightmap"))
    return terrain


def mujoco_terrain(given: str) -> ContactGeometry:
    """Return the contact geometry of a MuJoCo model.

    Raises:
        ConfigError: there is no such geometry.
    """
    terrain: ContactGeometry = chosen(given, "--terrain", CONTACT_GEOMETRIES)
    return terrain


def with_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Replace each parameter of an option class by the options that the class declares.

    A parameter of type `SourceOptions`, say, becomes an instance. One of type
    `Annotated[dict[str, Any], RunConfig]` becomes the options that were given, a tuple for each axis. Logs
    among the sources of a command with `SourceOptions` are mapped before it runs.
    """
    own = list(inspect.signature(command, eval_str=True).parameters.values())
    groups = {p.name: group for p in own if (group := _OptionGroup.of(p.annotation)) is not None}
    plain = [p for p in own if p.name not in groups]
    taken = {f"--{p.name.replace('_', '-')}" for p in plain}
    generated: dict[str, list[inspect.Parameter]] = {}
    for name, group in groups.items():
        generated[name] = list(group.parameters(taken))
        taken |= {flag for _, option in declared(group.kind) for flag in option.flags}

    @wraps(command)
    def wrapped(**given: Any) -> Any:
        for name, group in groups.items():
            given[name] = group.read({p.name: given.pop(p.name) for p in generated[name]})
        if isinstance(given.get("options"), SourceOptions):
            options = given.pop("options")
            given, given["options"] = with_logs_mapped(given, options)
        return command(**given)

    parameters = [*plain, *(p for found in generated.values() for p in found)]
    keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
    wrapped.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    wrapped.__annotations__ = {p.name: p.annotation for p in keywords}
    del wrapped.__wrapped__
    return wrapped


def typer_option(options: type[Options], name: str) -> Any:
    """Return the declaration of one option, for a command that takes no other."""
    declaration = dict(declared(options))[name]
    return _typer(declaration, declaration.flags)


@dataclass(frozen=True)
class _OptionGroup:
    """Options of a class as parameters of a command.

    Attributes:
        kind: the class.
        as_dict: whether the command takes the given options as a dict, without an instance.
    """

    kind: type[Options]
    as_dict: bool

    @classmethod
    def of(cls, annotation: Any) -> _OptionGroup | None:
        """Return the group that a parameter's annotation asks for; None = none."""
        if isinstance(annotation, type) and issubclass(annotation, Options):
            return cls(annotation, as_dict=False)
        for kind in getattr(annotation, "__metadata__", ()):
            if isinstance(kind, type) and issubclass(kind, Options):
                return cls(kind, as_dict=True)
        return None

    def parameters(self, taken: set[str]) -> Iterator[inspect.Parameter]:
        """Yield the parameters; flags that the command has itself stay the command's."""
        types, usual = get_type_hints(self.kind), defaults(self.kind)
        for name, option in declared(self.kind):
            if option.switch is not None:
                flag = typer.Option(option.switch.flag, help=option.switch.help, rich_help_panel=option.panel)
                yield _keyword(name + _SWITCH, False, Annotated[bool, flag])
            flags = tuple(flag for flag in option.flags if flag not in taken)
            default, written = usual[name], types[name]
            if option.axis is not None or option.read is not None:
                written = str if default is not None else str | None
            if self.as_dict and written is not bool:
                yield _keyword(name, None, Annotated[written | None, _typer(option, flags, default)])
            else:
                yield _keyword(name, default, Annotated[written, _typer(option, flags)])

    def read(self, given: Mapping[str, Any]) -> Any:
        """Return the options, or the given ones of them as a dict.

        Raises:
            ConfigError: a value is not legal, or two options contradict.
        """
        values = {name: self._value(option, name, given) for name, option in declared(self.kind)}
        if not self.as_dict:
            return self.kind(**values)
        usual = defaults(self.kind)
        return {n: v for n, v in values.items() if v is not None and not (v is False and usual[n] is False)}

    def _value(self, option: Option, name: str, given: Mapping[str, Any]) -> Any:
        value = given[name]
        if self.as_dict and option.axis is not None:
            return None if value is None else option.axis(value, option.flags[0])
        if option.read is not None:
            value = option.read(value, option.flags[0]) if value else None
        if value is None and option.switch is not None and given[name + _SWITCH]:
            return option.switch.value
        return value


def _typer(option: Option, flags: tuple[str, ...], default: Any = None) -> Any:
    """Return Typer's declaration; the help shows `default` in place of the parameter's own."""
    return typer.Option(
        *flags,
        metavar=option.metavar,
        help=option.help,
        rich_help_panel=option.panel,
        hidden=option.hidden,
        show_default=_text(default),
        autocompletion=_completer(option),
    )


def _completer(option: Option) -> Callable[[str], list[str]] | None:
    """Return the shell's completion of an option's names, also of the last one in a list.

    None if any value is legal.
    """
    words = [word for word in (option.metavar or "").split("|") if word.islower()]
    if not option.names and not words:
        return None

    def complete(incomplete: str) -> list[str]:
        names = option.names() if callable(option.names) else option.names or words
        before, comma, last = incomplete.rpartition(",")
        return [f"{before}{comma}{name}" for name in names if str(name).startswith(last)]

    return complete


def _text(default: Any) -> str | bool:
    """Return a default as the help shows it; True = the parameter's own default."""
    if default is None:
        return True
    return f"{default:g}" if isinstance(default, float) else str(default)


def _keyword(name: str, default: Any, annotation: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def with_logs_mapped(given: dict[str, Any], options: SourceOptions) -> tuple[dict[str, Any], SourceOptions]:
    """Replace the logs among a command's sources by their maps.

    Args:
        given: the command's own arguments: `source` or `sources`, and `output`.
        options: how sources become worlds; those that only concern a log's map are taken out.

    Raises:
        WctError: a log cannot be mapped, or its map cannot be written.
    """
    # The import loads much of SciPy, which would delay `--help`.
    from lirs_wct.sources.source import is_log

    sources = given.get("sources") or [given.get("source", "")]
    logs = [source for source in sources if source and is_log(Path(source))]
    if not logs:
        return given, options
    out = _folder(given.get("output"))
    maps = {log: _map_log(log, options, out) for log in logs}
    found = [maps.get(source, source) for source in sources]
    rest = replace(options, log_mapper=type(options)().log_mapper)
    if len(logs) == len(sources):
        rest = replace(rest, resolution=None)
    return given | ({"sources": found} if "sources" in given else {"source": found[0]}), rest


def _folder(output: Path | None) -> Path:
    """Return the folder for maps: the output folder, the output file's folder, or here."""
    if output is None:
        return Path()
    return output.parent if output.suffix else output


def _map_log(log: str, options: SourceOptions, out: Path) -> str:
    from lirs_validation.logs.map_log import resolve_source

    with progress_bar(log, err) as progress:
        path = resolve_source(log, options, out, progress)
    err.print(f"{log}: its map is {path}", soft_wrap=True, highlight=False)
    return str(path)
