"""The table of runs: on the screen and as Markdown; failures first and plainly named."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from lirs_validation.record.formatting import NOTHING, Entry, as_entry, figure_at, status_of, told
from lirs_validation.record.run_record import SOUND, RunRecord

COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("world", "world.name", "{}"),
    ("robot", "config.robot", "{}"),
    ("mapper", "config.mapper", "{}"),
    ("seed", "config.seed", "{}"),
    ("status", "status", "{}"),
    ("RTF", "rtf.mean", "{:.3g}"),
    ("driven [m]", "trajectory.length", "{:.1f}"),
    ("ATE [m]", "trajectory.ate_rmse", "{:.3f}"),
    ("F1", "map.f1", "{:.3f}"),
    ("F1 input", "map.f1_input", "{:.3f}"),
    ("false occ.", "map.false_occupied", "{:.3f}"),
)
"""Heading, place in the record, format."""
WORDS = ("world", "robot", "mapper", "status")
"""Columns that are aligned to the left."""
COMMON = ("robot", "mapper", "seed")
"""Columns that move into the title where all runs have the same."""


def results_table(records: Sequence[RunRecord | Entry]) -> Table:
    """Return the runs as a rich table; below it, in words, why runs failed.

    What all runs have in common stands above it, so that the table fits a terminal of 80 characters.
    """
    entries = ordered(records)
    reasons = _reasons(entries)
    common = [c for c in COLUMNS if c[0] in COMMON and len({told(e, c[1], c[2]) for e in entries}) == 1]
    table = Table(
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        title=Text(", ".join(_named(entries[0], c) for c in common)) if common else None,
        title_justify="left",
        caption=None if reasons is None else Text(reasons),
        caption_justify="left",
    )
    columns = [c for c in _shown(entries) if c not in common]
    for heading, place, form in columns:
        width = max(len(told(entry, place, form)) for entry in entries)
        table.add_column(
            Text(heading.replace(" ", "\n")),
            justify="left" if heading in WORDS else "right",
            min_width=min(width, 10),
            overflow="fold",
        )
    for entry in entries:
        failed = status_of(entry) not in SOUND
        # As plain text: a name may hold brackets, which rich would take for its markup.
        table.add_row(*(Text(told(entry, c[1], c[2])) for c in columns), style="bold red" if failed else "")
    return table


def markdown_table(records: Sequence[RunRecord | Entry]) -> str:
    """Return the same table as Markdown, as it stands in a README."""
    entries = ordered(records)
    columns = _shown(entries)
    lines = [
        "| " + " | ".join(heading for heading, _, _ in columns) + " |",
        "|" + "|".join("---" if heading in WORDS else "---:" for heading, _, _ in columns) + "|",
    ]
    for entry in entries:
        cells = (told(entry, place, form).replace("|", "\\|") for _, place, form in columns)
        lines.append("| " + " | ".join(cells) + " |")
    reasons = _reasons(entries)
    return "\n".join(lines) + "\n" + (f"\n{reasons}\n" if reasons else "")


def ordered(records: Sequence[RunRecord | Entry]) -> list[Entry]:
    """Return the records as nested dicts: failures first, else as they came."""
    return sorted((as_entry(r) for r in records), key=lambda entry: status_of(entry) in SOUND)


def _named(entry: Entry, column: tuple[str, str, str]) -> str:
    value = told(entry, column[1], column[2])
    return f"seed {value}" if column[0] == "seed" else value


def _shown(entries: Sequence[Entry]) -> list[tuple[str, str, str]]:
    """Leave out the comparison with an input map where no run had one."""
    with_input = any(figure_at(entry, "map.f1_input") is not None for entry in entries)
    return [c for c in COLUMNS if c[0] != "F1 input" or with_input]


def _reasons(entries: Sequence[Entry]) -> str | None:
    """Say in words what failed or was stopped and why, one line each; None where nothing was."""
    ended = [entry for entry in entries if status_of(entry) != "ok"]
    if not ended:
        return None
    return "\n".join(
        f"{told(e, 'world.name', '{}')}, {told(e, 'config.robot', '{}')}, {told(e, 'config.mapper', '{}')}, "
        f"seed {told(e, 'config.seed', '{}')}{_failed(e)}: {e.get('reason') or status_of(e) or NOTHING}"
        for e in ended
    )


def _failed(entry: Entry) -> str:
    return "" if status_of(entry) in SOUND else " failed"
