"""How far a long piece of work has come."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")
Tick = Callable[[float], None]
"""Called with the share that is done, 0 to 1."""
Report = Callable[[str, float], None]
"""Called with what is going on and the share of the whole that is done, 0 to 1."""


def ticking(items: Iterable[T], total: int, weight: Callable[[T], int], tick: Tick | None) -> Iterator[T]:
    """Yield the items; after each, tell the share of the total weight that has passed."""
    done = 0
    for item in items:
        yield item
        done += weight(item)
        if tick is not None:
            tick(min(1.0, done / max(total, 1)))


@dataclass
class Steps:
    """Work in named steps of equal weight, told as one share."""

    count: int
    report: Report | None = None
    begun: int = 0
    name: str = ""

    def begin(self, name: str) -> None:
        """Begin the next step."""
        self.begun, self.name = self.begun + 1, name
        self.tick(0.0)

    def tick(self, share: float) -> None:
        """Tell the share of the current step that is done."""
        if self.report is not None:
            self.report(self.name, min(1.0, (self.begun - 1 + share) / self.count))
