"""What a sweep came to, as tables on the screen."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.table import Table

from lirs_validation.record import read_record
from lirs_validation.report.table import results_table
from lirs_validation.sweep.collision_cell import CollisionCell, read_verdict
from lirs_validation.sweep.sweep import Sweep


def sweep_tables(sweep: Sweep) -> Iterator[Table]:
    """Yield a table of the runs, and one of the collision checks, where there are any."""
    from lirs_validation.collision_files import verdicts_table

    finished = [cell for cell in sweep.cells if cell.name in sweep.outcomes]
    entries = [_entry(sweep, cell.name) for cell in finished if not isinstance(cell, CollisionCell)]
    if entries:
        yield results_table(entries)
    checks = [cell for cell in finished if isinstance(cell, CollisionCell)]
    verdicts = [read_verdict(sweep.out / c.name) for c in checks if sweep.outcomes[c.name].sound]
    if verdicts:
        yield verdicts_table(verdicts)


def _entry(sweep: Sweep, name: str) -> dict[str, Any]:
    """Return a record without its series: thousands of them fit."""
    entry = read_record(sweep.out / name)
    entry["rtf"].pop("series", None)
    return entry
