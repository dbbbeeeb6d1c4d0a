"""A sweep: cells in, a folder of results out; what is finished already is not done again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from lirs_validation.sweep.cell import Cell
from lirs_validation.sweep.engines.base import Executor, ProgressOf
from lirs_validation.sweep.manifest import Manifest
from lirs_validation.sweep.outcome import Outcome
from lirs_wct.errors import OutputError, WctError
from lirs_wct.files import remove_leftovers
from lirs_wct.progress import no_progress

ROUNDS = 2
"""Times that a cell is run whose results cannot be written."""


class Sweep:
    """Cells and the folder for their results.

    Args:
        cells: what to run; of several with one name, one is.
        out: folder that receives a folder a cell, and `sweep.json`.
        manifest: what `sweep.json` says beside the cells.
        retry_failed: run cells again that failed before.

    Attributes:
        outcomes: of the cells that are finished, by name; small, for thousands of cells.
        kept: how many were finished before.
        unwritten: cells whose results could not be written, with the reason.

    Raises:
        WctError: a cell cannot be run as it was asked for; nothing has been run then.
    """

    def __init__(
        self,
        cells: Sequence[Cell],
        out: Path,
        *,
        manifest: Manifest | None = None,
        retry_failed: bool = False,
    ) -> None:
        for cell in cells:
            cell.check()
        self.cells = list({cell.name: cell for cell in cells}.values())
        self.out = out
        described = tuple(cell.described() for cell in self.cells)
        self._manifest: Manifest | None = replace(manifest or Manifest(), cells=described)
        remove_leftovers(out / cell.name for cell in self.cells)
        found = {cell.name: cell.finished(out) for cell in self.cells}
        self.outcomes = {
            name: outcome
            for name, outcome in found.items()
            if outcome is not None and (outcome.sound or not retry_failed)
        }
        self.kept = len(self.outcomes)
        self.unwritten: dict[str, str] = {}

    @property
    def pending(self) -> list[Cell]:
        """Cells that are still to be run, in their order."""
        return [cell for cell in self.cells if cell.name not in self.outcomes]

    @property
    def failed(self) -> bool:
        """Whether a cell failed, or was not finished."""
        return bool(self.pending) or not all(outcome.sound for outcome in self.outcomes.values())

    def run(
        self, executor: Executor, progress_of: ProgressOf = lambda name: no_progress
    ) -> Iterator[Outcome]:
        """Run what is pending; yield each outcome once its folder is written.

        Raises:
            WctError: the only cell cannot be run as it was asked for, or not be written.
        """
        if self.kept:
            self._save_manifest()
        for _ in range(ROUNDS):
            cells = {cell.name: cell for cell in self.pending}
            self.unwritten.clear()
            for outcome in executor.run(list(cells.values()), self.out, progress_of):
                settled = self._settled(cells[outcome.cell], outcome)
                if settled.written:
                    self.outcomes[settled.cell] = settled
                    self._save_manifest()
                    yield settled
                else:
                    self.unwritten[settled.cell] = settled.reason
            if not self.unwritten:
                break

    def _settled(self, cell: Cell, outcome: Outcome) -> Outcome:
        """Write down what failed outside a run."""
        if len(self.cells) == 1 and (outcome.bad_input or outcome.unwritable):
            raise WctError(outcome.reason)
        if outcome.written or outcome.unwritable:
            return outcome
        try:
            cell.write_failure(self.out, outcome)
        except OutputError as error:
            return replace(outcome, unwritable=True, reason=str(error))
        return replace(outcome, written=True)

    def _save_manifest(self) -> None:
        """Write `sweep.json` beside the first result: an interrupted first run leaves nothing at all."""
        if self._manifest is None:
            return
        try:
            self._manifest.save(self.out)
        except OutputError:
            return  # no room: with the next result then
        self._manifest = None
