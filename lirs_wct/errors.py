"""The errors that a user can cause and mend: one clear sentence each, exit code 2 at the command line."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable


class WctError(Exception):
    """Base of every error that names something the caller can change."""


class SourceError(WctError):
    """A source (picture, map, mesh, folder, log) cannot be used; the message begins with its path."""


class LogSourceError(SourceError):
    """A source is a laser log, where a world is needed: it is mapped first."""


class ConfigError(WctError, ValueError):
    """An option has a value that is not legal."""


class OutputError(WctError):
    """A result cannot be written; the message begins with its path."""


class SimulationError(WctError):
    """The simulation cannot go on (it diverged, or the robot cannot be placed)."""


class MapperError(WctError):
    """A mapper gave something that no mapper may give."""


_CLASS = re.compile(r"^(?:\w+\.)*\w*(?:Error|Exception|Warning):\s*")
"""Name of a Python class at the start of a message that a library built of another error."""


def reason_of(error: BaseException) -> str:
    """Return the cause of an error in plain words: one line, without the name of a Python class.

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
    text = _CLASS.sub("", " ".join(str(error).split()))
    return text or "is damaged"


_REASONS: dict[type[BaseException], str] = {
    EOFError: "ends too early",
    RecursionError: "is nested too deeply",
    MemoryError: "needs more memory than there is",
    OverflowError: "holds a number that is too large",
}


def unknown_name(kind: str, name: str, legal: Iterable[str]) -> ConfigError:
    """Return the error for a name that is none of the legal ones, which it lists.

    >>> str(unknown_name("robot", "huksy", ["husky", "jackal"]))
    "unknown robot 'huksy'; legal: husky, jackal"
    """
    return ConfigError(f"unknown {kind} {name!r}; legal: {', '.join(sorted(legal))}")
