"""The options of `build` as controls of a page, made from the declarations that the command line uses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from lirs_validation.config import SourceOptions
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.option import Option, Slider, declared
from lirs_wct.sources.source_kind import SourceKind
from slam_baselines.mapper import MAPPERS

FIRST_PANEL = "Source"
"""Heading of the options that the command line has without one."""
DEFAULT = "not given"
"""Stands for "not given" among choices."""
CHOICES = {"log_mapper": tuple(MAPPERS)}
"""Choices of a page where the command line takes anybody's code."""
Kind = Literal["switch", "choice", "slider", "text", "file"]


@dataclass(frozen=True, kw_only=True)
class Control:
    """A control of one option; its value is a bool, a float, or text.

    Attributes:
        name: of the option's field.
        kind: of control.
        title: beside it; the paper's name where it has one.
        panel: heading that it stands under.
        hint: help, with the flag at the command line.
        initial: value that stands for the default.
        choices: legal values of a choice.
        slider: of a number.
    """

    name: str
    kind: Kind
    title: str
    panel: str
    hint: str
    initial: bool | float | str
    choices: tuple[str, ...] = ()
    slider: Slider | None = None
    option: Option
    type: Any

    def shown_for(self, source: SourceKind) -> bool:
        """Whether the option has an effect on a source."""
        kinds = self.option.kinds
        mapped = source is SourceKind.LOG and kinds is not None and SourceKind.MAP in kinds
        return kinds is None or source in kinds or mapped

    def read(self, value: bool | float | str) -> Any:
        """Return the option's value.

        Raises:
            ConfigError: the text is no such value.
        """
        if value == self.initial and not isinstance(value, bool):
            return getattr(SourceOptions(), self.name)
        if not isinstance(value, str) or self.kind == "choice":
            return value
        if self.kind == "file":
            return Path(value)
        if self.option.read is not None:
            return self.option.read(value, self.title)
        return self._number(value)

    def _number(self, text: str) -> Any:
        kind = next((t for t in (int, float) if t in self._types), str)
        try:
            return kind(text)
        except ValueError:
            what = "a whole number" if kind is int else "a number"
            raise ConfigError(f"{self.title} must be {what}, got {text!r}") from None

    @property
    def _types(self) -> tuple[Any, ...]:
        return get_args(self.type) if get_origin(self.type) is UnionType else (self.type,)


def controls() -> Iterator[Control]:
    """Yield a control for every option that a source's world depends on."""
    types, defaults = get_type_hints(SourceOptions), SourceOptions()
    for name, option in declared(SourceOptions):
        kind, choices, initial = _kind(types[name], option, getattr(defaults, name))
        if name in CHOICES:
            kind, choices = "choice", CHOICES[name]
        form = f" Form: {option.metavar}." if kind == "text" and option.metavar else ""
        yield Control(
            name=name,
            kind=kind,
            title=option.title or option.label or name.replace("_", " "),
            panel=option.panel or FIRST_PANEL,
            hint=f"{option.help}{form} Command line: {option.flags[0]}",
            initial=initial,
            choices=choices,
            slider=option.slider,
            option=option,
            type=types[name],
        )


def _kind(written: Any, option: Option, default: Any) -> tuple[Kind, tuple[str, ...], Any]:
    """Return kind of control, its choices and its first value."""
    parts = get_args(written) if get_origin(written) is not Literal else (written,)
    if written is bool:
        return "switch", (), default
    if option.slider is not None:
        return "slider", (), option.slider.neutral
    if Path in parts:
        return "file", (), ""
    names = next((get_args(p) for p in (written, *parts) if get_origin(p) is Literal), ())
    if names:
        optional = NoneType in parts
        return "choice", (DEFAULT, *names) if optional else names, DEFAULT if optional else default
    return (
        "text",
        (),
        "" if default is None else f"{default:g}" if isinstance(default, float) else str(default),
    )


def read_controls(values: Mapping[str, bool | float | str], pixels: int) -> SourceOptions:
    """Return the options of a page's controls.

    Args:
        values: of the controls, by option.
        pixels: the server's limit for pictures.

    Raises:
        ConfigError: a value is not legal, or two options contradict.
        SourceError: more pixels are asked for than the server allows.
    """
    found = SourceOptions(**{c.name: c.read(values[c.name]) for c in controls() if c.name in values})
    if found.max_pixels > pixels:
        raise SourceError(f"max pixels: this server reads pictures of up to {pixels} pixels")
    return found
