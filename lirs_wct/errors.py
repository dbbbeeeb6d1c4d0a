"""Errors that a user can cause and correct: one sentence each, exit code 2."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from difflib import get_close_matches


class WctError(Exception):
    """Base of all errors that the caller can correct."""


class SourceError(WctError):
    """An unusable source: picture, map, mesh, folder or log; the message begins with its path."""


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


def unknown_name(kind: str, name: str, legal: Iterable[str]) -> ConfigError:
    """Return the error for an unknown name, with the legal and a similar one.

    >>> str(unknown_name("robot", "huksy", ["husky", "jackal"]))
    "unknown robot 'huksy'; legal: husky, jackal; did you mean husky?"
    """
    names = sorted(legal)
    return ConfigError(f"unknown {kind} {name!r}; legal: {', '.join(names)}{did_you_mean(name, names)}")


def did_you_mean(name: str, legal: Iterable[str]) -> str:
    """Return a clause with the most similar legal name; empty if none is similar."""
    similar = get_close_matches(str(name), tuple(legal), n=1)
    return f"; did you mean {similar[0]}?" if similar else ""
