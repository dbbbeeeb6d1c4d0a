"""The engine of one process: one cell after the other, nothing beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from lirs_validation.experiment.scenario import StageCache
from lirs_validation.sweep.cell import Cell, attempt
from lirs_validation.sweep.engines.base import ProgressOf
from lirs_validation.sweep.outcome import Outcome


class Serial:
    """One cell after the other in this process: nothing beside it, so its real-time factors count."""

    def run(self, cells: Sequence[Cell], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run cells into folders of `out`."""
        stages = StageCache()
        for cell in cells:
            yield attempt(cell, out, stages, progress_of(cell.name), concurrent=False)
