"""Options declared once, as dataclass fields with help and legal values.

Command line, page, sweep axes, digest, checks and reference are generated from the fields (`declared`).
"""

from __future__ import annotations

import inspect
import re
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import Enum
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from lirs_wct.errors import (
    Check,
    ConfigError,
    Names,
    did_you_mean,
    one_of as one_of,
    positive as positive,
    require_known,
    within as within,
)

_KEY = "option"
MAX_NUMBERS = 100_000
"""Largest length of a list such as 1-100000."""
YES, NO = ("true", "yes", "1"), ("false", "no", "0")

Reader = Callable[[str, str], Any]
"""Function of a text and the option's name that returns the value."""


@dataclass(frozen=True, kw_only=True)
class Slider:
    """Range of a number's slider on a page; the value `neutral` stands for "not given"."""

    low: float
    high: float
    step: float
    neutral: float


@dataclass(frozen=True, kw_only=True)
class Option:
    """Declaration of an option; name, type and default are those of its field.

    Attributes:
        help: one sentence or two.
        name: name of the field.
        type: type of the value.
        default: value if none is given; MISSING = one is required.
        positional: whether the command line takes it without a flag.
        rare: whether the command line takes it by `--option NAME=VALUE`.
        panel: heading in the help; None = the command's own.
        metavar: placeholder of the value in the help; empty = that of its type.
        unit: unit after the number in the text of the default.
        check: check of the value's legality, beside that of its type.
        reader: reader of the value; None = that of its type.
        axis: whether a sweep varies it: the command line then takes a list.
        names: values to choose from; empty = those of its type.
        complete: completion of the value in a shell; None = by `names`.
        shown: format of the value in the name of a group of runs.
        on_page: whether the live page offers it.
        in_digest: whether it distinguishes results and enters the name of their folder.
        kinds: kinds of source on which it has an effect; None = all.
        title: title of its control on a page, the paper's name if it has one; empty = the field's name.
        slider: slider of its control; None = a text field.
    """

    help: str
    name: str = ""
    type: Any = str
    default: Any = None
    positional: bool = False
    rare: bool = False
    panel: str | None = None
    metavar: str = ""
    unit: str = ""
    check: Check | None = None
    reader: Reader | None = None
    axis: bool = False
    names: Names = ()
    complete: Callable[[str], Collection[str]] | None = None
    shown: str = "{}"
    on_page: bool = True
    in_digest: bool = True
    kinds: Collection[Enum] | None = None
    title: str = ""
    slider: Slider | None = None

    @property
    def flag(self) -> str:
        """Flag on the command line."""
        return f"--{self.name.replace('_', '-')}"

    @property
    def label(self) -> str:
        """Name in messages."""
        return self.name.replace("_", " ")

    @property
    def types(self) -> tuple[Any, ...]:
        """Types of the value without None; of a tuple of any length, its elements'."""
        parts = get_args(self.type) if get_origin(self.type) in (Union, UnionType) else (self.type,)
        kinds = (get_args(part)[0] if get_args(part)[1:] == (...,) else part for part in parts)
        return tuple(kind for kind in kinds if kind is not NoneType)

    @property
    def is_list(self) -> bool:
        """Whether the value is a tuple of any length."""
        return get_args(self.type)[1:] == (...,)

    @property
    def words(self) -> tuple[str, ...]:
        """Legal words of a type that lists them."""
        if not all(get_origin(part) is Literal for part in self.types):
            return ()
        return tuple(word for part in self.types for word in get_args(part))

    @property
    def choices(self) -> tuple[Any, ...]:
        """Values to choose from; empty if there are too many to list."""
        return tuple(self.names() if callable(self.names) else self.names) or self.words

    @property
    def form(self) -> str:
        """Placeholder of the value."""
        forms = {bool: "true|false", int: "N", float: "X", Path: "PATH"}
        return self.metavar or "|".join(self.words) or forms.get(self.types[0], "TEXT")

    def arguments(self, text: str, has_flag: bool | None = None) -> tuple[str, ...]:
        """Return the words of a command line that set the option to a text.

        `has_flag` says whether the command has a flag for it; None = as declared.
        """
        if self.rare if has_flag is None else not has_flag:
            return "--option", f"{self.name}={text}"
        return (self.flag,) if self.type is bool else (self.flag, text)

    def check_value(self, value: Any) -> None:
        """Raise ConfigError for an illegal value; None is legal."""
        if value is None:
            return
        if self.words:
            for word in value if self.is_list else (value,):
                self._check_word(word, self.label)
        if self.check is not None:
            self.check(value, self.label)

    def read(self, text: str, label: str) -> Any:
        """Return the value of a text, for an axis the values of a list."""
        if self.axis or self.is_list:
            return (self.reader or LISTS.get(self.types[0], read_names))(text, label)
        return self.read_one(text, label)

    def read_one(self, text: str, label: str) -> Any:
        """Return the value of a text, of an axis one value."""
        kind = self.types[0]
        if self.reader is not None and not self.axis:
            return self.reader(text, label)
        if self.words:
            self._check_word(text, label)
            return text
        if kind is bool:
            if text.lower() not in (*YES, *NO):
                raise ConfigError(f"{label} must be true or false, got {text!r}")
            return text.lower() in YES
        return kind(text) if kind in (Path, str) else _read_numbers(text, label, self)

    def _check_word(self, word: Any, label: str) -> None:
        if word not in self.words:
            names = f"{', '.join(self.words[:-1])} or {self.words[-1]}"
            raise ConfigError(f"{label} must be {names}, got {word!r}{did_you_mean(word, self.words)}")


def option(default: Any, help: str, **given: Any) -> Any:
    """Return a dataclass field with a default and an `Option`."""
    return field(default=default, metadata={_KEY: Option(help=help, **given)})


def argument(help: str, metavar: str, default: Any = MISSING, **given: Any) -> Any:
    """Return a field of a value without a flag, which a default makes optional."""
    return option(default, help, metavar=metavar, positional=True, **given)


def declared(options: type[Options]) -> Mapping[str, Option]:
    """Return the declared fields of a class by name."""
    kind: Any = options  # mypy doubts that classes are hashable
    return _declared(kind)


@cache
def _declared(options: Any) -> Mapping[str, Option]:
    types = get_type_hints(options)
    return {
        entry.name: replace(
            entry.metadata[_KEY], name=entry.name, type=types[entry.name], default=entry.default
        )
        for entry in fields(options)
        if _KEY in entry.metadata
    }


def defaults(options: type[Options]) -> dict[str, Any]:
    """Return the default of each declared field that has one."""
    return {name: o.default for name, o in declared(options).items() if o.default is not MISSING}


def check_names(options: type[Options], given: Iterable[str]) -> None:
    """Raise ConfigError unless every given name is a field."""
    legal = [entry.name for entry in fields(options)]
    for name in given:
        require_known("option", name, legal)


def changed(options: Options) -> dict[str, Any]:
    """Return the declared fields whose values differ from their defaults."""
    usual = defaults(type(options))
    return {name: getattr(options, name) for name in usual if getattr(options, name) != usual[name]}


def command_line(command: str, source: str, options: Options, **others: Any) -> str:
    """Return the command with the changed options of a source, and `others`."""
    known = declared(type(options))
    values = changed(options) | others
    words = (word for name, value in values.items() for word in known[name].arguments(str(value)))
    return shlex.join(["lirs-wct", command, source, *words])


def digest_fields(options: Options) -> dict[str, Any]:
    """Return the changed fields that distinguish results; numbers have the type of their default."""
    counted = declared(type(options))
    return {
        name: float(value) if isinstance(counted[name].default, float) else value
        for name, value in changed(options).items()
        if counted[name].in_digest
    }


@dataclass(frozen=True, kw_only=True)
class Options:
    """Base of option classes; each value passes its declared check."""

    def __post_init__(self) -> None:
        for name, option in declared(type(self)).items():
            option.check_value(getattr(self, name))


Declared = TypeVar("Declared", bound=type[Options])


def documented(options: Declared) -> Declared:
    """Append each option's help to the attributes of its class's docstring."""
    text, raises, errors = inspect.cleandoc(options.__doc__ or "").partition("\n\nRaises:")
    heading = () if "Attributes:" in text else ("", "Attributes:")
    lines = (f"    {name}: {option.help}" for name, option in declared(options).items())
    options.__doc__ = "\n".join((text, *heading, *lines)) + raises + errors
    return options


def _read_numbers(text: str, label: str, declaration: Option) -> Any:
    """Return one number, or as many comma-separated ones as a type wants."""
    wanted = {len(get_args(kind)): (*get_args(kind), kind)[0] for kind in declaration.types}
    kind = next(iter(wanted.values()))
    try:
        values = tuple(kind(part) for part in text.split(","))
    except ValueError:
        values = ()
    if wanted.keys() == {0}:
        if len(values) != 1:
            raise ConfigError(f"{label} must be a {'whole ' if kind is int else ''}number, got {text!r}")
        return values[0]
    if (0 if len(values) == 1 else len(values)) not in wanted or not values:
        raise ConfigError(f"{label} must be {declaration.form}, got {text!r}")
    return values if len(values) > 1 else values[0]


def read_pairs(text: str, label: str) -> dict[str, str]:
    """Return names and values of a list such as `mapper=hector,world=medium`; of "" none."""
    pairs = [part.partition("=") for part in (text.split(",") if text else ())]
    if not all(name.strip() and value.strip() for name, _, value in pairs):
        raise ConfigError(f"{label} must be NAME=VALUE,NAME=VALUE,..., got {text!r}")
    return {name.strip(): value.strip() for name, _, value in pairs}


def read_names(text: str, label: str) -> tuple[str, ...]:
    """Return the names of a comma-separated list, without repetitions."""
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise ConfigError(f"{label} must be a list such as a,b,c, got {text!r}")
    return tuple(dict.fromkeys(names))


def read_factors(text: str, label: str) -> tuple[float, ...]:
    """Return the numbers of a list such as `0.5,1,2`, without repetitions."""
    try:
        return tuple(dict.fromkeys(float(part) for part in text.split(",")))
    except ValueError:
        raise ConfigError(f"{label} must be a list such as 0.5,1,2, got {text!r}") from None


def read_numbers(text: str, label: str) -> tuple[int, ...]:
    """Return the whole numbers of a list such as `1-5` or `1,3,7-9`, without repetitions."""
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,9})(?:-(\d{1,9}))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if last < first or last - first >= MAX_NUMBERS:
            raise ConfigError(f"{label} must be a list such as 1-5 or 1,3,7-9, got {text!r}")
        numbers += range(first, last + 1)
    return tuple(dict.fromkeys(numbers))


LISTS: Mapping[Any, Reader] = {int: read_numbers, float: read_factors}
"""Readers of lists by the type of an element; others are lists of names."""
