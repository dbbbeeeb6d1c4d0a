"""Engines: where the cells of a sweep are run. One interface; what comes of a cell does not depend on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from lirs_validation.experiment.scenario import StageCache
from lirs_validation.sweep.cell import Cell, attempt
from lirs_validation.sweep.outcome import Outcome
from lirs_wct.errors import ConfigError, unknown_name

ENGINES = ("serial", "processes", "ray")
MOST_MEMORY = 1e18
"""Bytes that the system can be asked to keep a process below."""

Progress = Callable[[str, str, float], None]
"""Called with a cell's name, the stage of its work and the share that is done."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a cell may use before it is stopped; a limit needs a process of its own for the cell.

    Attributes:
        seconds: wall-clock time of a whole cell; None = any.
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
    """Runs cells, each at least once, and tells of each exactly once, as it ends."""

    def run(self, cells: Sequence[Cell], out: Path, progress: Progress) -> Iterator[Outcome]:
        """Run cells into folders of `out`; failures are outcomes too, and not written by the executor."""
        ...


class Serial:
    """One cell after the other in this process: nothing beside it, so its real-time factors count."""

    def run(self, cells: Sequence[Cell], out: Path, progress: Progress) -> Iterator[Outcome]:
        """Run cells into folders of `out`."""
        stages = StageCache()
        for cell in cells:

            def tell(stage: str, share: float, name: str = cell.name) -> None:
                progress(name, stage, share)

            yield attempt(cell, out, stages, tell, concurrent=False)


def make_executor(
    engine: str | None,
    *,
    jobs: int | None = None,
    address: str | None = None,
    limits: Limits | None = None,
) -> Executor:
    """Make an engine.

    Args:
        engine: one of ENGINES; None = `serial`, or `processes` where more than one job is asked for.
        jobs: cells at a time; None = one, or with `processes` one a core.
        address: of a Ray cluster; None = one is started on this machine.
        limits: of a cell.

    Raises:
        ConfigError: the options contradict, or Ray is not installed.
    """
    limits = limits or Limits()
    chosen = engine or ("processes" if jobs is not None and jobs > 1 else "serial")
    if chosen not in ENGINES:
        raise unknown_name("engine", chosen, ENGINES)
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs must be 1 or more, got {jobs}")
    if address is not None and chosen != "ray":
        raise ConfigError(f"--address is of a Ray cluster; the engine is {chosen}")
    if chosen == "ray":
        from lirs_validation.sweep.engines.ray import RayCluster

        return RayCluster(address=address, jobs=jobs, limits=limits)
    if chosen == "serial" and jobs not in (None, 1):
        raise ConfigError(f"--engine serial runs one cell at a time, got --jobs {jobs}")
    if chosen == "serial" and not limits.any:
        return Serial()
    from lirs_validation.sweep.engines.processes import Processes, cores

    return Processes(jobs=1 if chosen == "serial" else jobs or cores(), limits=limits)
