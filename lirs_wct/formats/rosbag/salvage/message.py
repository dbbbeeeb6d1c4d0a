"""Messages of damaged files."""

from __future__ import annotations

from typing import NamedTuple


class Topic(NamedTuple):
    """A topic: name, type, and the type's definition and digest (empty = unknown)."""

    name: str
    kind: str
    definition: str = ""
    digest: str = ""


class SalvagedMessage(NamedTuple):
    """A message: topic, time of recording in nanoseconds, and bytes."""

    topic: Topic
    stamp: int
    data: bytes
