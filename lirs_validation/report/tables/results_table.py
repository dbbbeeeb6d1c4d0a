"""The table of runs: on the screen and as Markdown; failures first and plainly named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from lirs_validation.analysis.groups import RunGroup, unusual_fields
from lirs_validation.config import RUN_AXES
from lirs_validation.record.formatting import Entry, as_entry, text_at
from lirs_validation.record.metric_catalog import Metric, metrics_selected
from lirs_validation.record.odometry import worse_lines, worse_than_odometry
from lirs_validation.record.run_record import RunRecord, succeeded
from lirs_validation.report.tables.screen import FittedTable
from lirs_validation.report.tables.table import ReportTable

FACTS = {"world": "world.name", **{name: f"config.{name}" for name in RUN_AXES}, "status": "status"}
"""Columns before the metrics, and their keys in the record."""
ALWAYS = ("world", "robot", "mapper", "seed", "status")
"""Columns that are shown even if every run has the default."""
LEAST = ("driven [m]",)
"""Columns that are left out first where the screen is narrow."""
COMMON = RUN_AXES
"""Columns that move into the title where all runs have the same."""


@dataclass(frozen=True)
class Column:
    """A column: its heading, the text of a run in it, whether it is one of FACTS and no metric."""

    heading: str
    text: Callable[[Entry], str]
    fact: bool = False


def results_table(records: Sequence[RunRecord | Entry]) -> FittedTable:
    """Return the runs for the screen; below them why runs failed, and which are worse than their odometry.

    What all runs have in common stands above it, so that the table fits a terminal of 80 characters.
    """
    entries = ordered(records)
    shown = _columns(entries)
    common = [c for c in shown if c.heading in COMMON and len({c.text(e) for e in entries}) == 1]
    columns = [c for c in shown if c not in common]
    table = ReportTable(
        "runs",
        "",
        _remarks(entries),
        tuple(column.heading for column in columns),
        tuple(tuple(column.text(entry) for column in columns) for entry in entries),
        sum(column.fact for column in columns),
    )
    title = ", ".join(_named(entries[0], column) for column in common)
    return FittedTable(table, title=title, styles=[_style(entry) for entry in entries], drop=LEAST)


def markdown_table(records: Sequence[RunRecord | Entry]) -> str:
    """Return the same table as Markdown, as it stands in a README."""
    entries = ordered(records)
    columns = _columns(entries)
    lines = [
        "| " + " | ".join(c.heading for c in columns) + " |",
        "|" + "|".join("---" if c.fact and c.heading != "seed" else "---:" for c in columns) + "|",
    ]
    for entry in entries:
        cells = (c.text(entry).replace("|", "\\|") for c in columns)
        lines.append("| " + " | ".join(cells) + " |")
    remarks = _remarks(entries)
    return "\n".join(lines) + "\n" + (f"\n{remarks}\n" if remarks else "")


def ordered(records: Sequence[RunRecord | Entry]) -> list[Entry]:
    """Return the records as nested dicts: failures first, else as they came."""
    return sorted((as_entry(r) for r in records), key=succeeded)


def _columns(entries: Sequence[Entry]) -> list[Column]:
    shown = {*ALWAYS, *unusual_fields(map(RunGroup.of, entries))}
    facts = [
        Column(name, partial(text_at, key=key), fact=True) for name, key in FACTS.items() if name in shown
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


def _style(entry: Entry) -> str:
    if not succeeded(entry):
        return "bold red"
    return "yellow" if worse_than_odometry(entry) else ""


def _remarks(entries: Sequence[Entry]) -> str:
    """Return what failed or was stopped and why, and what is worse than its odometry, one line each."""
    ended = [entry for entry in entries if entry["status"] != "ok"]
    lines = []
    for entry in ended:
        who = [text_at(entry, FACTS[fact]) for fact in ("world", "robot", "mapper")]
        run = f"{', '.join(who)}, seed {text_at(entry, FACTS['seed'])}"
        lines.append(
            f"{run}{'' if succeeded(entry) else ' failed'}: {entry.get('reason') or entry['status']}"
        )
    return "\n".join((*lines, *worse_lines(entries)))
