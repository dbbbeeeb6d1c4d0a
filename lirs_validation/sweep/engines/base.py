"""The interface of engines, which run the experiments of a sweep; results do not depend on the engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from lirs_validation.sweep.experiment import Experiment
from lirs_validation.sweep.outcome import Outcome
from lirs_wct.errors import ConfigError
from lirs_wct.progress import Progress

MOST_MEMORY = 1e18
"""Bytes that the system can be asked to keep a process below."""

ProgressOf = Callable[[str], Progress]
"""Gives each experiment, by its name, the progress of its own work."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What an experiment may use before it is stopped; a limit needs a process of its own.

    Attributes:
        seconds: wall-clock time of a whole experiment; None = any.
        memory: private memory of its process, bytes; None = any.

    Raises:
        ConfigError: a limit is not above 0, or not finite.
    """

    seconds: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        if self.seconds is not None and not self.seconds > 0:
            raise ConfigError(f"the cell timeout must be above 0 s, got {self.seconds:g}")
        if self.memory is not None and not 0 < self.memory <= MOST_MEMORY:
            raise ConfigError(f"the cell's memory must be above 0 bytes, got {self.memory:g}")

    @property
    def any(self) -> bool:
        """Whether there is a limit at all."""
        return self.seconds is not None or self.memory is not None


class Executor(Protocol):
    """Runs experiments, each at least once, and yields one outcome for each, as it ends."""

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`; failures are outcomes, which the caller writes."""
        ...
