"""Readers of options: comma-separated numbers, choices, a pose."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Any

from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.geometry.pose import Pose2
from lirs_wct.option import Reader

MAX_NUMBERS = 100_000
"""Length of a list such as 1-100000 at most."""


def numbers(form: str, *counts: int) -> Reader:
    """Return a reader of as many comma-separated numbers as are legal; `form` says so in the error."""

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
    """Return a reader of so many comma-separated whole numbers."""
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
    """Return the text, which must be one of the legal words.

    Raises:
        ConfigError: it is none of them.
    """
    if text not in legal:
        raise ConfigError(f"{flag} must be {', '.join(legal[:-1])} or {legal[-1]}, got {text!r}")
    return text


def name_of(legal: Collection[str]) -> Reader:
    """Return a reader of one of the legal names, which lists them otherwise."""

    def read(text: str, flag: str) -> str:
        if text not in legal:
            raise unknown_name(flag, text, legal)
        return text

    return read


def read_extent(text: str, flag: str) -> float | tuple[float, ...]:
    """Read a longer side, or width and height."""
    sides: tuple[float, ...] = numbers("W or W,H in meters", 1, 2)(text, flag)
    return sides[0] if len(sides) == 1 else sides


def read_factors(text: str, flag: str) -> tuple[float, float, float]:
    """Read one factor for all axes, or one for each."""
    factors = numbers("S or SX,SY,SZ", 1, 3)(text, flag)
    return factors[0], factors[len(factors) // 2], factors[-1]


def read_pose(text: str, flag: str) -> Pose2:
    """Read x, y and yaw, which may be left out."""
    return Pose2(*numbers("X,Y or X,Y,YAW in meters and radians", 2, 3)(text, flag))


def read_names(text: str, flag: str) -> tuple[str, ...]:
    """Return the names of a comma-separated list, without repetitions.

    Raises:
        ConfigError: a name is missing.
    """
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise ConfigError(f"{flag} must be a list such as a,b,c, got {text!r}")
    return tuple(dict.fromkeys(names))


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
