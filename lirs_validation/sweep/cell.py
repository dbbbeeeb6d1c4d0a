"""A cell: one experiment of a sweep, and the folder that it fills."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import StageCache
from lirs_validation.sweep.outcome import Outcome, outcome_of
from lirs_wct.progress import Progress


class Cell(Protocol):
    """One experiment: the same cell gives the same folder, wherever and however often it is run."""

    @property
    def name(self) -> str:
        """Name of its folder; tells it from every other cell."""
        ...

    @property
    def place(self) -> RunConfig:
        """A config of the world that it takes place in."""
        ...

    def check(self) -> None:
        """Look at everything that can be looked at before the world is built.

        Raises:
            WctError: the cell cannot be run as it was asked for.
        """
        ...

    def perform(self, out: Path, stages: StageCache, progress: Progress, *, concurrent: bool) -> Outcome:
        """Run, and write the folder whole or not at all.

        Raises:
            WctError: it cannot be run, or not written.
        """
        ...

    def write_failure(self, out: Path, outcome: Outcome) -> None:
        """Write the folder of a cell that came to nothing: its record, and `error.txt`.

        Raises:
            OutputError: the folder cannot be written.
        """
        ...

    def finished(self, out: Path) -> Outcome | None:
        """Return how the cell ended when its folder was written; None where it is to be run (again)."""
        ...

    def described(self) -> dict[str, Any]:
        """Return what the sweep's file says about the cell."""
        ...


def attempt(cell: Cell, out: Path, stages: StageCache, progress: Progress, *, concurrent: bool) -> Outcome:
    """Perform a cell; whatever it raises becomes its outcome."""
    try:
        return cell.perform(out, stages, progress, concurrent=concurrent)
    except Exception as error:
        return outcome_of(error, cell.name)
