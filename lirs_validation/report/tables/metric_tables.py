"""The tables of a report: failures, metrics by group, metrics by run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from lirs_validation.analysis.groups import FIELDS, RunGroup, by_group, distinguishing_fields, unusual_fields
from lirs_validation.analysis.repeats import repeats
from lirs_validation.record.formatting import Entry
from lirs_validation.record.metric_catalog import Metric, Section, metrics_in, metrics_selected, rtf_counts
from lirs_validation.record.odometry import ATE, WORSE, WORSE_MARK, worse_than_odometry
from lirs_validation.record.run_record import succeeded
from lirs_validation.report.tables.table import Content, ReportTable, Spread

EXTRAPOLATED = "†"
SECTIONS: dict[Section, str] = {
    "rtf": "Real-time factor",
    "trajectory": "Trajectory",
    "map": "Map",
    "contacts": "Contacts while mapping",
    "cost": "Cost",
}
"""Sections of the report and their titles."""
MOST_NAMED = 12
"""Groups that a caption names one by one."""


def failures_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the runs that failed, and why."""
    failed = [entry for entry in entries if not succeeded(entry)]
    groups = [RunGroup.of(e) for e in entries]
    fields = tuple(dict.fromkeys(("world", "robot", "mapper", *unusual_fields(groups))))
    rows = [
        (*group_texts(RunGroup.of(e), fields), str(e["seed"]),
         str(e["status"]), str(e["reason"] or e["status"]), str(e["name"]))
        for e in failed
    ]  # fmt: skip
    headings = (*fields, "seed", "status", "reason", "folder")
    caption = f"{len(failed)} of {len(entries)} runs failed; they are in no mean below."
    return ReportTable("failures", "Failures", caption, headings, tuple(rows), len(headings))


def failure_lines(entries: Sequence[Entry]) -> list[str]:
    """Return the runs that failed and why, a line each, and how many they are."""
    failed = [entry for entry in entries if not succeeded(entry)]
    fields = distinguishing_fields(by_group(entries))
    fields = tuple(field for field in FIELDS if field in {"world", "robot", "mapper", *fields})
    lines = [
        f"{RunGroup.of(e).named(fields)}, seed {e['seed']} failed: {e['status']}"
        + (f": {e['reason']}" if e["reason"] else "")
        for e in failed
    ]
    return (
        [*lines, f"{len(failed)} of {len(entries)} runs failed; they are in no mean below."] if lines else []
    )


def summary_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the metrics that one asks for first, group by group, with how many runs succeeded."""
    return group_table("summary", "Summary", metrics_selected("summary"), entries, count=True)


def section_by_group(section: Section, entries: Sequence[Entry]) -> ReportTable:
    """Return the means of a section's metrics, group by group."""
    return group_table(section, SECTIONS[section], metrics_in(section), entries)


def section_by_run(section: Section, entries: Sequence[Entry]) -> ReportTable:
    """Return a section's metrics, run by run."""
    fields = _fields(by_group(entries))
    kept = _existing(metrics_in(section), entries)
    headings = (*fields, "seed", "status", *(metric.heading for metric in kept))
    rows = [
        (
            *group_texts(RunGroup.of(e), fields),
            str(e["seed"]),
            str(e["status"]),
            *(over_runs(m, [e]) for m in kept),
        )
        for e in entries
    ]
    title = f"{SECTIONS[section]}, run by run"
    return ReportTable(f"{section}-runs", title, "", headings, tuple(rows), len(fields) + 2)


def group_table(
    key: str, title: str, metrics: Sequence[Metric], entries: Sequence[Entry], *, count: bool = False
) -> ReportTable:
    """Return means over the runs of each group that succeeded, with 95 % intervals over seeds."""
    groups = by_group(entries)
    fields = _fields(groups)
    kept = _existing(metrics, entries)
    headings = (*fields, *(("succeeded",) if count else ()), *(metric.heading for metric in kept))
    rows = []
    for group, runs in groups.items():
        good = [run for run in runs if succeeded(run)]
        counted = (f"{len(good)} of {len(runs)}",) if count else ()
        rows.append((*group_texts(group, fields), *counted, *(over_runs(metric, good) for metric in kept)))
    caption = _caption(kept, entries)
    if any(isinstance(cell, Spread) and cell.partial for row in rows for cell in row):
        caption += " (n of N): n of the N runs have this value."
    return ReportTable(key, title, caption, headings, tuple(rows), len(fields) + count)


def over_runs(metric: Metric, entries: Sequence[Entry]) -> Spread:
    """Return a metric over runs; the RTF of runs that were not alone on the machine is left out."""
    values = [v for e in entries if (v := metric.comparable(e)) is not None]
    stopped = metric.section == "rtf" and any(e["rtf"]["extrapolated"] for e in entries if rtf_counts(e))
    worse = metric.key == ATE and any(map(worse_than_odometry, entries))
    mark = EXTRAPOLATED if stopped else WORSE_MARK if worse else ""
    return Spread(metric, repeats(values), mark, len(entries))


def _caption(metrics: Sequence[Metric], entries: Sequence[Entry]) -> str:
    """Return what the numbers are, over how many seeds, and what was left out."""
    seeds = {sum(map(succeeded, runs)) for runs in by_group(entries).values()}
    if max(seeds, default=0) <= 1:
        lines = ["One seed: one run's values, without any interval."]
    else:
        lines = ["Mean over seeds ± half width of its 95 % interval (Student's t)."]
        if min(seeds) <= 1:
            lines.append("Without ±: one seed that succeeded.")
    if any(metric.section == "rtf" for metric in metrics):
        beside = sum(bool(e["rtf"]) and not rtf_counts(e) for e in entries)
        if beside:
            runs, have = ("run", "has") if beside == 1 else ("runs", "have")
            lines.append(f"{beside} {runs} with something running beside {have} no RTF here.")
        if any(e["rtf"] and e["rtf"]["extrapolated"] for e in entries):
            lines.append(f"{EXTRAPOLATED} extrapolated: some drives were stopped at their wall limit.")
    if any(metric.key == ATE for metric in metrics):
        lines += _worse(entries)
    return " ".join(lines)


def _worse(entries: Sequence[Entry]) -> list[str]:
    """Return which groups have runs that are worse than their odometry, in one sentence; none where none."""
    groups = by_group([entry for entry in entries if succeeded(entry)])
    fields = _fields(groups)
    named = []
    for group, runs in groups.items():
        worse = sum(map(worse_than_odometry, runs))
        if worse:
            named.append(f"{group.named(fields)} ({worse} of {len(runs)} run{'s' if len(runs) > 1 else ''})")
    more = f" and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else ""
    return [f"{WORSE_MARK} {WORSE}: {'; '.join(named[:MOST_NAMED])}{more}."] if named else []


def _fields(groups: Mapping[RunGroup, Any]) -> tuple[str, ...]:
    """Return the fields that distinguish the groups, world and mapper always."""
    different = {"world", "mapper", *distinguishing_fields(groups)}
    return tuple(field for field in FIELDS if field in different)


def group_texts(group: RunGroup, fields: Sequence[str]) -> tuple[Content, ...]:
    """Return the values of a group's fields as text."""
    values = [group[field] for field in fields]
    return tuple(f"{v:g} s" if isinstance(v, float) else str(v) for v in values)


def _existing(metrics: Sequence[Metric], entries: Sequence[Entry]) -> tuple[Metric, ...]:
    """Return the metrics that at least one record has."""
    return tuple(m for m in metrics if any(m.of(e) is not None for e in entries))
