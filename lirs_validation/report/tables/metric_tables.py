"""The tables of a report: failures, figures by cell, figures by run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from lirs_validation.analysis.groups import FIELDS, Cell, by_cell, telling
from lirs_validation.analysis.repeats import repeats
from lirs_validation.record import catalog
from lirs_validation.record.catalog import Figure, rtf_counts
from lirs_validation.record.run_record import SOUND
from lirs_validation.report.tables.table import Content, Sheet, Spread

Entry = Mapping[str, Any]

EXTRAPOLATED = "†"
GROUPS: tuple[tuple[str, str, tuple[Figure, ...]], ...] = (
    ("rtf", "Real-time factor", catalog.RTF),
    ("trajectory", "Trajectory", catalog.TRAJECTORY),
    ("map", "Map", catalog.MAP),
    ("contacts", "Contacts while mapping", catalog.CONTACTS),
    ("cost", "Cost", catalog.COST),
)
SUMMARY = tuple(
    figure
    for figure in catalog.ALL
    if figure.place
    in ("rtf.mean", "trajectory.length", "trajectory.ate_rmse", "map.f1", "map.iou", "map.false_occupied")
)


def sound(entry: Entry) -> bool:
    """Whether a run did not fail."""
    return entry["status"] in SOUND


def failures_sheet(entries: Sequence[Entry]) -> Sheet:
    """Return the runs that failed, and why."""
    failed = [entry for entry in entries if not sound(entry)]
    rows = [
        (*_cell_words(Cell.of(e), ("world", "robot", "mapper", "terrain", "rays")), str(e["seed"]),
         str(e["status"]), str(e["reason"] or e["status"]), str(e["name"]))
        for e in failed
    ]  # fmt: skip
    headings = ("world", "robot", "mapper", "terrain", "rays", "seed", "status", "reason", "folder")
    caption = f"{len(failed)} of {len(entries)} runs failed; their figures are in no mean below."
    return Sheet("failures", "Failures", caption, headings, tuple(rows), words=len(headings))


def summary_sheet(entries: Sequence[Entry]) -> Sheet:
    """Return the figures that one asks for first, cell by cell, with how many runs are sound."""
    return cell_sheet("summary", "Summary", SUMMARY, entries, count=True)


def cell_sheet(
    key: str, title: str, wanted: Sequence[Figure], entries: Sequence[Entry], *, count: bool = False
) -> Sheet:
    """Return the mean of figures over the sound runs of each cell, with 95 % intervals over seeds."""
    cells = by_cell(entries)
    fields = _fields(cells)
    kept = _existing(wanted, entries)
    headings = (*fields, *(("sound runs",) if count else ()), *(f.heading for f in kept))
    rows = []
    for cell, runs in cells.items():
        good = [run for run in runs if sound(run)]
        counted = (f"{len(good)} of {len(runs)}",) if count else ()
        rows.append((*_cell_words(cell, fields), *counted, *(over_runs(figure, good) for figure in kept)))
    words = len(fields) + count
    return Sheet(key, title, caption_of(kept, entries), headings, tuple(rows), words)


def run_sheet(key: str, title: str, wanted: Sequence[Figure], entries: Sequence[Entry]) -> Sheet:
    """Return figures run by run."""
    fields = _fields(by_cell(entries))
    kept = _existing(wanted, entries)
    headings = (*fields, "seed", "status", *(f.heading for f in kept))
    rows = [
        (
            *_cell_words(Cell.of(e), fields),
            str(e["seed"]),
            str(e["status"]),
            *(over_runs(f, [e]) for f in kept),
        )
        for e in entries
    ]
    return Sheet(f"{key}-runs", f"{title}, run by run", "", headings, tuple(rows), len(fields) + 2)


def over_runs(figure: Figure, entries: Sequence[Entry]) -> Spread:
    """Return a figure over runs; the RTF of runs that were not alone on the machine is none."""
    counted = [e for e in entries if not figure.place.startswith("rtf.") or rtf_counts(e)]
    values = [v for e in counted if (v := figure.of(e)) is not None]
    stopped = figure.place.startswith("rtf.") and any(e["rtf"]["extrapolated"] for e in counted)
    return Spread(figure, repeats(values), EXTRAPOLATED if stopped else "")


def caption_of(wanted: Sequence[Figure], entries: Sequence[Entry]) -> str:
    """Say what the numbers are, over how many seeds, and what was left out."""
    seeds = {len([r for r in runs if sound(r)]) for runs in by_cell(entries).values()}
    if max(seeds, default=0) <= 1:
        lines = ["One seed: one run's figures, without any interval."]
    else:
        lines = ["Mean over seeds ± half width of its 95 % interval (Student's t)."]
        if min(seeds) <= 1:
            lines.append("Without ±: one sound seed.")
    if any(f.place.startswith("rtf.") for f in wanted):
        beside = sum(bool(e["rtf"]) and not rtf_counts(e) for e in entries)
        if beside:
            runs, have = ("run", "has") if beside == 1 else ("runs", "have")
            lines.append(f"{beside} {runs} with something running beside {have} no RTF here.")
        if any(e["rtf"] and e["rtf"]["extrapolated"] for e in entries):
            lines.append(f"{EXTRAPOLATED} extrapolated: some drives were stopped at their wall limit.")
    return " ".join(lines)


def _fields(cells: Mapping[Cell, Any]) -> tuple[str, ...]:
    """Return the fields that tell the cells apart, world and mapper always."""
    different = {"world", "mapper", *telling(cells)}
    return tuple(field for field in FIELDS if field in different)


def _cell_words(cell: Cell, fields: Sequence[str]) -> tuple[Content, ...]:
    values = [getattr(cell, field) for field in fields]
    return tuple(f"{v:g} s" if isinstance(v, float) else str(v) for v in values)


def _existing(wanted: Sequence[Figure], entries: Sequence[Entry]) -> tuple[Figure, ...]:
    """Return the figures that at least one record has."""
    return tuple(f for f in wanted if any(f.of(e) is not None for e in entries))
