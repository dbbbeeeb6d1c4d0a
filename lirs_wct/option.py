"""Options declared once, as dataclass fields with help, command-line flag and legal values.

Command line, page, sweep axes, digest, checks and reference are generated from the fields (`declared`).
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import Enum
from typing import Any, TypeVar

from lirs_wct.errors import ConfigError, unknown_name

_KEY = "option"
MAX_NUMBERS = 100_000
"""Largest length of a list such as 1-100000."""

Check = Callable[[Any, str], None]
"""Function of a value (never None) and its name that raises ConfigError for an illegal value."""
Reader = Callable[[str, str], Any]
"""Function of a command line's text and the flag that returns the value."""
Names = Collection[Any] | Callable[[], Collection[Any]]
"""Legal values, or a function that returns them if their import is slow."""


@dataclass(frozen=True, kw_only=True)
class Switch:
    """A command-line flag without value that stands for a value of an option.

    Attributes:
        flag: spelling at the command line.
        value: value of the option that the flag sets.
        help: one sentence.
    """

    flag: str
    value: Any
    help: str


@dataclass(frozen=True, kw_only=True)
class Slider:
    """Range of a number's slider on a page.

    Attributes:
        low: smallest value.
        high: largest value.
        step: distance of two values.
        neutral: value without effect; it stands for "not given".
    """

    low: float
    high: float
    step: float
    neutral: float


@dataclass(frozen=True, kw_only=True)
class Option:
    """Declaration of an option; type and default are those of its field.

    Attributes:
        help: one sentence or two.
        panel: heading in the help; None = the command's own.
        metavar: placeholder of the value in the help; None = its type.
        flags: command-line flags, the usual one first; empty = the field's name.
        label: name in errors; empty = the field's name.
        check: check of the value's legality.
        read: reader of the value; None = the reader of its type.
        axis: reader of a list of values that a sweep varies; None = the option has one value.
        names: values that a page offers; empty = those of its type.
        shown: format of the value in the name of a group of runs.
        hidden: whether the command line's help omits it.
        on_page: whether the live page offers it.
        in_digest: whether it distinguishes results and enters the name of their folder.
        switch: flag that stands for a value.
        kinds: kinds of source on which it has an effect; None = all.
        title: title of its control on a page, the paper's name if it has one; empty = the field's name.
        slider: slider of its control; None = a text field.
    """

    help: str
    panel: str | None = None
    metavar: str | None = None
    flags: tuple[str, ...] = ()
    label: str = ""
    check: Check | None = None
    read: Reader | None = None
    axis: Reader | None = None
    names: Names = ()
    shown: str = "{}"
    hidden: bool = False
    on_page: bool = True
    in_digest: bool = True
    switch: Switch | None = None
    kinds: Collection[Enum] | None = None
    title: str = ""
    slider: Slider | None = None


def option(default: Any, help: str, **given: Any) -> Any:
    """Return a dataclass field with a default and an `Option`."""
    return field(default=default, metadata={_KEY: Option(help=help, **given)})


def declared(options: type[Options]) -> Iterator[tuple[str, Option]]:
    """Yield the name and `Option` of each declared field; its default flag is its name."""
    for entry in fields(options):
        if _KEY in entry.metadata:
            found: Option = entry.metadata[_KEY]
            usual = (f"--{entry.name.replace('_', '-')}",)
            yield entry.name, found if found.flags else replace(found, flags=usual)


def defaults(options: type[Options]) -> dict[str, Any]:
    """Return the default of each declared field that has one."""
    names = dict(declared(options))
    return {f.name: f.default for f in fields(options) if f.name in names and f.default is not MISSING}


def check_names(options: type[Options], given: Iterable[str]) -> None:
    """Raise ConfigError unless every given name is a declared field."""
    legal = dict(declared(options))
    for name in given:
        if name not in legal:
            raise unknown_name("option", name, legal)


def changed(options: Options) -> dict[str, Any]:
    """Return the declared fields whose values differ from their defaults."""
    usual = defaults(type(options))
    return {name: getattr(options, name) for name in usual if getattr(options, name) != usual[name]}


def digest_fields(options: Options) -> dict[str, Any]:
    """Return the changed fields that distinguish results; numbers have the type of their default."""
    usual, counted = defaults(type(options)), dict(declared(type(options)))
    return {
        name: float(value) if isinstance(usual[name], float) else value
        for name, value in changed(options).items()
        if counted[name].in_digest
    }


@dataclass(frozen=True, kw_only=True)
class Options:
    """Base of option classes; each value passes its declared check.

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
    """Append the help of each option to the attributes in the docstring of a class of options."""
    text, raises, errors = inspect.cleandoc(options.__doc__ or "").partition("\n\nRaises:")
    heading = () if "Attributes:" in text else ("", "Attributes:")
    lines = (f"    {name}: {found.help}" for name, found in declared(options))
    options.__doc__ = "\n".join((text, *heading, *lines)) + raises + errors
    return options


def positive(value: float | Iterable[float], label: str) -> None:
    """Check that a number, or each of several numbers, is finite and above 0."""
    for number in value if isinstance(value, Iterable) else (value,):
        if not 0 < number < math.inf:
            raise ConfigError(f"{label} must be a finite number above 0, got {number}")


def within(legal: str, unit: str = "") -> Check:
    """Return a check that a number lies in an interval such as "[0, inf)" or "(0, 360]"; NaN never does."""
    low, high = (float(bound) for bound in legal[1:-1].split(","))
    closed = legal[0] == "["
    words = f"within {legal}" if high < math.inf else f"{'at least' if closed else 'above'} {low:g}"

    def check(value: float, label: str) -> None:
        above = value >= low if closed else value > low
        if not (above and (value <= high if legal[-1] == "]" else value < high)):
            raise ConfigError(f"{label} must be {words}{unit and f' {unit}'}, got {value}")

    return check


def one_of(legal: Names) -> Check:
    """Return a check that a value is one of the legal names."""

    def check(value: Any, label: str) -> None:
        names = legal() if callable(legal) else legal
        if value not in names:
            raise unknown_name(label, value, names)

    return check


def numbers(form: str, *counts: int) -> Reader:
    """Return a reader of comma-separated numbers; an error names the legal `form`.

    Args:
        form: legal form in the error.
        *counts: legal numbers of values.
    """

    def read(text: str, flag: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) not in counts:
            raise ConfigError(f"{flag} must be {form}, got {text!r}")
        return values

    return read


def whole_numbers(form: str, count: int) -> Reader:
    """Return a reader of `count` comma-separated whole numbers."""
    reader = numbers(form, count)

    def read(text: str, flag: str) -> tuple[int, ...]:
        values = reader(text, flag)
        if any(not value.is_integer() for value in values):
            raise ConfigError(f"{flag} must be {form}, got {text!r}")
        return tuple(int(value) for value in values)

    return read


def choice(*legal: str) -> Reader:
    """Return a reader of one of the legal words."""
    return lambda text, flag: chosen(text, flag, legal)


def chosen(text: str, flag: str, legal: tuple[Any, ...]) -> Any:
    """Return the text if it is one of the legal words.

    Raises:
        ConfigError: the text is illegal.
    """
    if text not in legal:
        raise ConfigError(f"{flag} must be {', '.join(legal[:-1])} or {legal[-1]}, got {text!r}")
    return text


def name_of(legal: Collection[str]) -> Reader:
    """Return a reader of one of the legal names; an error lists them."""

    def read(text: str, flag: str) -> str:
        if text not in legal:
            raise unknown_name(flag, text, legal)
        return text

    return read


def read_names(text: str, flag: str) -> tuple[str, ...]:
    """Return the names of a comma-separated list, without repetitions.

    Raises:
        ConfigError: a name is missing.
    """
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise ConfigError(f"{flag} must be a list such as a,b,c, got {text!r}")
    return tuple(dict.fromkeys(names))


def read_factors(text: str, flag: str) -> tuple[float, ...]:
    """Return the numbers of a list such as `0.5,1,2`, without repetitions.

    Raises:
        ConfigError: the text is no such list.
    """
    try:
        return tuple(dict.fromkeys(float(part) for part in text.split(",")))
    except ValueError:
        raise ConfigError(f"{flag} must be a list such as 0.5,1,2, got {text!r}") from None


def read_numbers(text: str, flag: str) -> tuple[int, ...]:
    """Return the whole numbers of a list such as `1-5` or `1,3,7-9`, without repetitions.

    Raises:
        ConfigError: the text is no such list, or has too many numbers.
    """
    found: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,9})(?:-(\d{1,9}))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if last < first or last - first >= MAX_NUMBERS:
            raise ConfigError(f"{flag} must be a list such as 1-5 or 1,3,7-9, got {text!r}")
        found += range(first, last + 1)
    return tuple(dict.fromkeys(found))
