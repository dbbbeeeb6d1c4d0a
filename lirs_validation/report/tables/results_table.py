"""The table of runs: on the screen and as Markdown; failures first and plainly named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from rich.table import Table
from rich.text import Text

from lirs_validation.record.formatting import Entry, as_entry, text_at
from lirs_validation.record.metric_catalog import Metric, metrics_selected
from lirs_validation.record.run_record import RunRecord, succeeded
from lirs_validation.report.tables.screen import screen_table

FACTS = {
    "world": "world.name",
    "robot": "config.robot",
    "mapper": "config.mapper",
    "attitude": "config.attitude",
    "seed": "config.seed",
    "status": "status",
}
"""Columns before the metrics, and their places in the record."""
COMMON = ("robot", "mapper", "attitude", "seed")
"""Columns that move into the title where all runs have the same."""


@dataclass(frozen=True)
class Column:
    """A column: its heading, the text of a run in it, whether it is aligned to the left."""

    heading: str
    text: Callable[[Entry], str]
    left: bool = False


def results_table(records: Sequence[RunRecord | Entry]) -> Table:
    """Return the runs as a rich table; below it why runs failed.

    What all runs have in common stands above it, so that the table fits a terminal of 80 characters.
    """
    entries = ordered(records)
    reasons = _reasons(entries)
    shown = _columns(entries)
    common = [c for c in shown if c.heading in COMMON and len({c.text(e) for e in entries}) == 1]
    table = screen_table(", ".join(_named(entries[0], c) for c in common), reasons)
    columns = [c for c in shown if c not in common]
    for column in columns:
        width = max(len(column.text(entry)) for entry in entries)
        table.add_column(
            Text(column.heading.replace(" ", "\n")),
            justify="left" if column.left else "right",
            min_width=min(width, 10),
            overflow="fold",
        )
    for entry in entries:
        # As plain text: a name may hold brackets, which rich would take for its markup.
        cells = (Text(column.text(entry)) for column in columns)
        table.add_row(*cells, style="" if succeeded(entry) else "bold red")
    return table


def markdown_table(records: Sequence[RunRecord | Entry]) -> str:
    """Return the same table as Markdown, as it stands in a README."""
    entries = ordered(records)
    columns = _columns(entries)
    lines = [
        "| " + " | ".join(c.heading for c in columns) + " |",
        "|" + "|".join("---" if c.left else "---:" for c in columns) + "|",
    ]
    for entry in entries:
        cells = (c.text(entry).replace("|", "\\|") for c in columns)
        lines.append("| " + " | ".join(cells) + " |")
    reasons = _reasons(entries)
    return "\n".join(lines) + "\n" + (f"\n{reasons}\n" if reasons else "")


def ordered(records: Sequence[RunRecord | Entry]) -> list[Entry]:
    """Return the records as nested dicts: failures first, else as they came."""
    return sorted((as_entry(r) for r in records), key=succeeded)


def _columns(entries: Sequence[Entry]) -> list[Column]:
    facts = [
        Column(name, partial(text_at, key=key), name != "seed")
        for name, key in FACTS.items()
        if name != "attitude" or any(text_at(entry, key) == "none" for entry in entries)
    ]
    metrics = [
        m
        for m in metrics_selected("runs")
        if not m.optional or any(m.of(entry) is not None for entry in entries)
    ]
    return facts + [_metric_column(metric) for metric in metrics]


def _metric_column(metric: Metric) -> Column:
    return Column(metric.short or metric.heading, lambda entry: metric.formatted(metric.of(entry)))


def _named(entry: Entry, column: Column) -> str:
    text = column.text(entry)
    return text if column.heading in ("robot", "mapper") else f"{column.heading} {text}"


def _reasons(entries: Sequence[Entry]) -> str:
    """Return what failed or was stopped and why, one line each."""
    ended = [entry for entry in entries if entry["status"] != "ok"]
    lines = []
    for entry in ended:
        who = [text_at(entry, FACTS[fact]) for fact in ("world", "robot", "mapper")]
        run = f"{', '.join(who)}, seed {text_at(entry, FACTS['seed'])}"
        lines.append(
            f"{run}{'' if succeeded(entry) else ' failed'}: {entry.get('reason') or entry['status']}"
        )
    return "\n".join(lines)
