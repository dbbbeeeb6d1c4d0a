"""Text of records and numbers, with the same digits everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any

NOTHING = "-"
"""Text of a value that does not exist."""

Entry = Mapping[str, Any]
"""A record as nested dicts."""


def as_entry(record: object) -> Entry:
    """Return a run's or a file's record as nested dicts."""
    if isinstance(record, Mapping):
        return record
    if not is_dataclass(record) or isinstance(record, type):
        raise TypeError(f"a record must be a RunRecord or nested dicts, got {type(record).__name__}")
    return asdict(record)


def value_at(entry: Entry, key: str) -> Any:
    """Return the value at a dotted key; None where it does not exist."""
    found: Any = entry
    for part in key.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def text_at(entry: Entry, key: str) -> str:
    """Return the text at a dotted key."""
    value = value_at(entry, key)
    return NOTHING if value is None else str(value)


def significant(value: float) -> str:
    """Return a number with three significant digits, and no exponent.

    >>> significant(0.01094), significant(41.27), significant(1234.5)
    ('0.0109', '41.3', '1234')
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def span(values: Sequence[float]) -> str:
    """Return the smallest and the largest of numbers, or the one number."""
    low, high = significant(min(values)), significant(max(values))
    return low if low == high else f"{low} to {high}"
