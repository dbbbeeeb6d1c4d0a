"""Progress callback of builders, writers, runs and sweeps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")
Progress = Callable[[str, float], None]
"""Function of the current step's name and the completed share of all work, 0 to 1."""


def no_progress(step: str, share: float) -> None:
    """Ignore progress."""


def track(
    items: Iterable[T], total: int, weight: Callable[[T], int], step: str, progress: Progress = no_progress
) -> Iterator[T]:
    """Yield the items; after each, report the share of the total weight that has passed."""
    done = 0
    for item in items:
        yield item
        done += weight(item)
        progress(step, min(1.0, done / max(total, 1)))


@dataclass
class Steps:
    """A number of named steps of equal weight, reported as one share."""

    count: int
    progress: Progress = no_progress
    begun: int = 0

    def begin(self, name: str) -> Progress:
        """Begin the next step; return the progress of that step alone."""
        before, self.begun = self.begun, self.begun + 1

        def progress(_: str, share: float) -> None:
            self.progress(name, min(1.0, (before + share) / self.count))

        progress(name, 0.0)
        return progress
