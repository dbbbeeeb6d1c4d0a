"""An option declared once: a field with its help, its spelling at a command line, and what is legal.

A command line is made from the fields (`declared`), as are checks and warnings: a new option is a new field.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from typing import Any, TypeVar

from lirs_wct.errors import ConfigError, unknown_name

_KEY = "option"

Check = Callable[[Any, str], None]
"""Raises ConfigError for a value that is not legal; called with the value, never None, and its name."""
Reader = Callable[[str, str], Any]
"""Text at a command line -> value; called with the text and the flag."""


@dataclass(frozen=True, kw_only=True)
class Switch:
    """A flag without value that stands for a value of an option.

    Attributes:
        flag: at the command line.
        value: that it stands for.
        help: one sentence.
    """

    flag: str
    value: Any
    help: str


@dataclass(frozen=True, kw_only=True)
class Slider:
    """Usual values of a number, for a slider on a page.

    Attributes:
        low: smallest.
        high: largest.
        step: between two.
        neutral: changes nothing, and stands for "not given".
    """

    low: float
    high: float
    step: float
    neutral: float


@dataclass(frozen=True, kw_only=True)
class Option:
    """What a field of options says beside its type and default.

    Attributes:
        help: one sentence or two.
        panel: heading in the help; None = the command's own.
        metavar: stands for the value in the help; None = its type.
        flags: at the command line, the first is the usual one; empty = the field's name.
        label: name in errors; empty = the field's name.
        check: legality.
        read: reader of the value; None = as its type is read.
        switch: flag that stands for a value.
        kinds: of source on which it has an effect; None = all.
        title: of its control on a page, the paper's name where it has one; empty = the field's name.
        slider: of its control; None = a field to write in.
    """

    help: str
    panel: str | None = None
    metavar: str | None = None
    flags: tuple[str, ...] = ()
    label: str = ""
    check: Check | None = None
    read: Reader | None = None
    switch: Switch | None = None
    kinds: Collection[Enum] | None = None
    title: str = ""
    slider: Slider | None = None


def option(default: Any, help: str, **given: Any) -> Any:
    """Return a dataclass field with a default and an `Option`."""
    return field(default=default, metadata={_KEY: Option(help=help, **given)})


def declared(options: type[Options]) -> Iterator[tuple[str, Option]]:
    """Yield name and `Option` of each field, the flag of its name filled in."""
    for entry in fields(options):
        found: Option = entry.metadata[_KEY]
        usual = (f"--{entry.name.replace('_', '-')}",)
        yield entry.name, found if found.flags else replace(found, flags=usual)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options that are checked as they declare.

    Raises:
        ConfigError: a value is not legal.
    """

    def __post_init__(self) -> None:
        for name, found in declared(type(self)):
            value = getattr(self, name)
            if value is not None and found.check is not None:
                found.check(value, found.label or name.replace("_", " "))


Declared = TypeVar("Declared", bound=type[Options])


def documented(options: Declared) -> Declared:
    """Return a class of options with the help of each in its docstring."""
    lines = (f"    {name}: {found.help}" for name, found in declared(options))
    options.__doc__ = "\n".join((inspect.cleandoc(options.__doc__ or ""), "", "Attributes:", *lines))
    return options


def positive(value: float | Iterable[float], label: str) -> None:
    """Check that a number, or each of several, is finite and above 0."""
    for number in value if isinstance(value, Iterable) else (value,):
        if not 0 < number < math.inf:
            raise ConfigError(f"{label} must be a finite number above 0, got {number}")


def one_of(legal: Collection[str]) -> Check:
    """Return a check that a value is one of the legal names."""

    def check(value: str, label: str) -> None:
        if value not in legal:
            raise unknown_name(label, value, legal)

    return check
