"""Messages as they come out of damaged files."""

from __future__ import annotations

from typing import NamedTuple


class Topic(NamedTuple):
    """A topic: its name, its type, and the type's definition and digest, empty where they are not known."""

    name: str
    kind: str
    definition: str = ""
    digest: str = ""


class SalvagedMessage(NamedTuple):
    """A message: its topic, when it was recorded, nanoseconds, and its bytes."""

    topic: Topic
    stamp: int
    data: bytes
