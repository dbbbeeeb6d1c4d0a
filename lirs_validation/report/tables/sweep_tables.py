"""What a sweep came to, as tables on the screen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from lirs_validation.analysis.groups import by_group, distinguishing_fields
from lirs_validation.record.run_record import read_record
from lirs_validation.report.tables.collision_table import verdicts_table
from lirs_validation.report.tables.method_tables import method_tables
from lirs_validation.report.tables.metric_tables import failure_lines, summary_table
from lirs_validation.report.tables.results_table import results_table
from lirs_validation.report.tables.screen import FittedTable
from lirs_validation.sweep.collision_experiment import CollisionExperiment, read_verdict
from lirs_validation.sweep.sweep import Sweep

FIELDS = {"world", "robot", "mapper"}
"""Fields that the table of single runs has columns for, beside the seed."""


def sweep_tables(sweep: Sweep) -> Iterator[RenderableType]:
    """Yield tables of what is finished: means of groups or single runs, methods as published, verdicts."""
    finished = [found for found in sweep.experiments if found.name in sweep.outcomes]
    entries = [_entry(sweep, run.name) for run in finished if not isinstance(run, CollisionExperiment)]
    groups = by_group(entries)
    if len(groups) < len(entries) or not set(distinguishing_fields(groups)) <= FIELDS:
        yield from _by_group(entries)
    elif entries:
        yield results_table(entries)
    for table in method_tables(entries):
        yield FittedTable(table, title=table.title)
    checks = [check for check in finished if isinstance(check, CollisionExperiment)]
    verdicts = [read_verdict(sweep.out / c.name) for c in checks if sweep.outcomes[c.name].succeeded]
    if verdicts:
        yield verdicts_table(verdicts)


def _by_group(entries: Sequence[dict[str, Any]]) -> Iterator[RenderableType]:
    """Yield the failures, if any, and the means of each group."""
    failures = failure_lines(entries)
    if failures:
        yield Text("\n".join(failures), style="bold red")
    yield FittedTable(summary_table(entries))


def _entry(sweep: Sweep, name: str) -> dict[str, Any]:
    """Return a record without its series: thousands of them fit."""
    entry = read_record(sweep.out / name)
    entry["rtf"].pop("series", None)
    return entry
