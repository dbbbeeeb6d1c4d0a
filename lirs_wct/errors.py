"""The errors that a user can cause and mend: one clear sentence each, exit code 2 at the command line."""

from __future__ import annotations

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


def unknown_name(kind: str, name: str, legal: Iterable[str]) -> ConfigError:
    """Return the error for a name that is none of the legal ones, which it lists.

    >>> str(unknown_name("robot", "huksy", ["husky", "jackal"]))
    "unknown robot 'huksy'; legal: husky, jackal"
    """
    return ConfigError(f"unknown {kind} {name!r}; legal: {', '.join(sorted(legal))}")
