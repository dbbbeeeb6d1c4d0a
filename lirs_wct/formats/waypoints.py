"""Waypoint files: text, CSV or YAML with x, y and optional yaw.

Meters and radians in the world frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lirs_wct.errors import SourceError
from lirs_wct.formats.yaml_text import load_yaml

LEAST = 2
"""Least number of waypoints in a file: start and goal."""
NAMES = ("x", "y", "yaw")


@dataclass(frozen=True)
class RoutePoint:
    """A position to reach; `yaw` = heading there, None = any."""

    x: float
    y: float
    yaw: float | None = None


def read_waypoints(path: Path) -> tuple[RoutePoint, ...]:
    """Read waypoints.

    Text and CSV: one waypoint per line, numbers separated by commas or blanks. `#` begins a comment, and a
    first line `x,y,yaw` is a heading. YAML (`.yaml`, `.yml`): a list of `[x, y]`, `[x, y, yaw]` or
    `{x: ..., y: ..., yaw: ...}`, plain or under `waypoints:`.

    Raises:
        SourceError: missing or damaged, fewer than two waypoints, or one without two or three finite numbers.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise SourceError(f"{path}: no text: {error}") from error
    entries = _yaml(path, text) if path.suffix.lower() in (".yaml", ".yml") else _lines(text)
    found = tuple(_waypoint(path, place, values) for place, values in entries)
    if len(found) < LEAST:
        raise SourceError(
            f"{path}: at least {LEAST} waypoints are needed, the first is the start; got {len(found)}"
        )
    return found


def _lines(text: str) -> list[tuple[str, Any]]:
    """Return the line name and the words of each waypoint."""
    found: list[tuple[str, Any]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        heading = not found and [word.lower() for word in words] in (list(NAMES), list(NAMES[:2]))
        if words and not heading:
            found.append((f"line {number}", words))
    return found


def _yaml(path: Path, text: str) -> list[tuple[str, Any]]:
    """Return the name and the values of each waypoint."""
    try:
        entries = load_yaml(text)
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error
    if isinstance(entries, dict) and set(entries) == {"waypoints"}:
        entries = entries["waypoints"]
    if not isinstance(entries, list):
        raise SourceError(f"{path}: a YAML list of waypoints is needed, got {entries!r:.40}")
    return [
        (f"waypoint {k}", _values(entry) if isinstance(entry, dict) else entry)
        for k, entry in enumerate(entries, 1)
    ]


def _values(entry: dict[Any, Any]) -> list[Any]:
    """Return the values of `{x, y, yaw}` in this order; nothing of other mappings."""
    known = set(entry) in ({"x", "y"}, set(NAMES))
    return [entry[name] for name in NAMES if name in entry] if known else []


def _waypoint(path: Path, place: str, values: Any) -> RoutePoint:
    try:
        numbers = [float(value) for value in values if not isinstance(value, bool)]
    except (TypeError, ValueError):
        numbers = []
    whole = isinstance(values, list) and len(numbers) == len(values)
    if not whole or len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise SourceError(
            f"{path}: {place}: a waypoint is x, y and perhaps yaw (finite numbers), got {values!r}"
        )
    return RoutePoint(*numbers)
