"""Errors that a user can cause and correct, and the checks of values that raise them.

An error is one sentence with name, legal values and given value; the exit code is 2.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from numbers import Integral, Real
from types import UnionType
from typing import Any, ClassVar, TypeGuard, TypeVar


class WctError(Exception):
    """Base of all errors that the caller can correct."""


class SourceError(WctError):
    """An unusable source: picture, map, mesh, folder or log; the message begins with its path."""


class MapPictureWarning(UserWarning):
    """A picture read as terrain that looks like a laser map."""


class LogSourceError(SourceError):
    """A laser log as source where a world is needed; it must be mapped first."""


class ConfigError(WctError, ValueError):
    """An option with an illegal value."""


class OptionError(ConfigError, TypeError):
    """An unknown keyword argument; a `TypeError` too, as Python raises for a function."""


class OutputError(WctError):
    """A result that cannot be written; the message begins with its path."""


class SimulationError(WctError):
    """A simulation that cannot continue: it diverged, or the robot cannot be placed."""


class MapperError(WctError):
    """An illegal result of a mapper."""


_CLASS = re.compile(r"^(?:\w+\.)*\w*(?:Error|Exception|Warning):\s*")
"""Python class name at the start of a library's error message."""


def reason_of(error: BaseException) -> str:
    """Return the cause of an error as one line without Python class names.

    >>> reason_of(KeyError("schema"))
    "'schema' is missing"
    """
    if isinstance(error, UnicodeDecodeError):
        return f"is not text: byte {error.start} is not {error.encoding.upper()}"
    if isinstance(error, json.JSONDecodeError):
        return f"is not JSON: line {error.lineno}: {error.msg}"
    if isinstance(error, KeyError) and error.args:
        return f"{error.args[0]!r} is missing"
    if isinstance(error, OSError) and error.strerror:
        return f"cannot be read: {error.strerror}"
    for kind, reason in _REASONS.items():
        if isinstance(error, kind):
            return reason
    if "integer string conversion" in str(error):
        return "holds a number with too many digits"
    if "validation error" in str(error) and hasattr(error, "errors"):  # of pydantic
        first = error.errors()[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    text = _CLASS.sub("", " ".join(str(error).split()))
    return text or "is damaged"


_REASONS: dict[type[BaseException], str] = {
    EOFError: "ends too early",
    RecursionError: "is nested too deeply",
    MemoryError: "needs more memory than there is",
    OverflowError: "holds a number that is too large",
}


MAX_NAMES = 40
"""Longest list of legal names in a message; of more, the most similar ones are named."""


def unknown_name(kind: str, name: str, legal: Iterable[str]) -> ConfigError:
    """Return the error for an unknown name, with the legal and a similar one.

    >>> str(unknown_name("robot", "huksy", ["husky", "jackal"]))
    "unknown robot 'huksy'; legal: husky, jackal; did you mean husky?"
    """
    names = sorted(legal)
    shown = names if len(names) <= MAX_NAMES else get_close_matches(str(name), names, n=5, cutoff=0.0)
    more = f" and {len(names) - len(shown)} more" if len(names) > len(shown) else ""
    listed = ", ".join(shown) + more
    return ConfigError(f"unknown {kind} {name!r}; legal: {listed}{did_you_mean(name, names)}")


def require_known(kind: str, name: Any, legal: Iterable[Any]) -> None:
    """Raise the error for an unknown name unless it is legal."""
    names = tuple(legal)
    if name not in names:
        raise unknown_name(kind, name, names)


def did_you_mean(name: str, legal: Iterable[str]) -> str:
    """Return a clause with the most similar legal name; empty if none is similar."""
    similar = get_close_matches(str(name), tuple(legal), n=1)
    return f"; did you mean {similar[0]}?" if similar else ""


_KEY = "check"
T = TypeVar("T")

Check = Callable[[Any, str], None]
"""Function of a value and its name that raises ConfigError for an illegal value."""
Names = Collection[Any] | Callable[[], Collection[Any]]
"""Legal values, or a function that returns them if their import is slow."""


@dataclass(frozen=True, kw_only=True)
class Checked:
    """Base of configurations; each value passes the check of its field.

    A subclass names its owner in messages: `class LaserConfig(Checked, of="the laser")`.

    Raises:
        ConfigError: a value is not legal.
    """

    _owner: ClassVar[str] = ""

    def __init_subclass__(cls, of: str | None = None) -> None:
        super().__init_subclass__()
        if of is not None:
            cls._owner = f" of {of}"

    def __post_init__(self) -> None:
        for entry in fields(self):
            if _KEY in entry.metadata:
                value = getattr(self, entry.name)
                if value is not None or entry.default is not None:
                    entry.metadata[_KEY](value, f"{entry.name}{self._owner}")


def limited(default: T, legal: str, unit: str = "", *, whole: bool = False) -> T:
    """Return a field whose number lies in an interval (see `within`).

    None is legal only if it is the default.
    """
    return field(default=default, metadata={_KEY: within(legal, unit, whole=whole)})


def check_field(check: Check, **given: Any) -> Any:
    """Return a dataclass field with a check; the arguments are those of `dataclasses.field`."""
    return field(metadata={_KEY: check}, **given)


def within(legal: str, unit: str = "", *, whole: bool = False) -> Check:
    """Return a check that a number lies in an interval.

    The interval is a text such as "(0, 360]", "[0, inf)" or, if infinity is legal, "(0, inf]". NaN and a
    bool are never legal.
    """
    low, high = (float(bound) for bound in legal[1:-1].split(","))
    from_low, to_high = legal[0] == "[", legal[-1] == "]"
    words = f"within {legal}" if high < math.inf else f"{'at least' if from_low else 'above'} {low:g}"

    def holds(value: Any) -> bool:
        if not is_number(value, Integral if whole else Real):
            return False
        return (value >= low if from_low else value > low) and (value <= high if to_high else value < high)

    def check(value: Any, label: str) -> None:
        if not holds(value):
            finite = high == math.inf and not to_high and not isinstance(value, Integral)
            kind = "a whole number " if whole else "a finite number " if finite else ""
            got = value if is_number(value) else repr(value)
            raise ConfigError(f"{label} must be {kind}{words}{unit and f' {unit}'}, got {got}")

    return check


def positive(value: Any, label: str) -> None:
    """Check that a number, or each of several numbers, is finite and above 0."""
    for number in value if isinstance(value, Iterable) else (value,):
        within("(0, inf)")(number, label)


def check_seed(seed: Any, label: str = "seed") -> None:
    """Check that a seed is a whole number of at least 0."""
    within("[0, inf)", whole=True)(seed, label)


def one_of(legal: Names) -> Check:
    """Return a check that a value is one of the legal names."""

    def check(value: Any, label: str) -> None:
        require_known(label, value, legal() if callable(legal) else legal)

    return check


def of_type(kind: type | UnionType) -> Check:
    """Return a check that a value has a type."""

    def check(value: Any, label: str) -> None:
        if not isinstance(value, kind):
            legal = getattr(kind, "__name__", str(kind))
            raise ConfigError(f"{label} must be of type {legal}, got {value!r}")

    return check


def require_within(config: Any, legal: str, *names: str, of: str = "", unit: str = "") -> None:
    """Raise ConfigError unless every named field lies in an interval that only its dataclass knows.

    The owner in messages is a text such as "the motion filter".
    """
    check = within(legal, unit)
    for name in names:
        check(getattr(config, name), f"{name} of {of}" if of else name)


def is_finite(value: object) -> bool:
    """Whether a value is a finite number."""
    return is_number(value) and math.isfinite(value)


def is_number(value: object, kind: type = Real) -> TypeGuard[float]:
    """Whether a value is a number (of a kind) and not a bool."""
    return isinstance(value, kind) and not isinstance(value, bool)
