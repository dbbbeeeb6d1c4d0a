"""Tables of runs: one row a run or group, failures, methods as published, all tables of a sweep."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from rich.console import RenderableType
from rich.text import Text

from lirs_validation.analysis.groups import (
    FIELDS,
    ORIGINAL,
    RunGroup,
    by_group,
    distinguishing_fields,
    repeats,
    unusual_fields,
)
from lirs_validation.config import RUN_AXES
from lirs_validation.record.metric_catalog import (
    ATE,
    ODOMETRY_ATE,
    WORSE,
    WORSE_MARK,
    Entry,
    Metric,
    Section,
    metrics_in,
    metrics_named,
    metrics_selected,
    rtf_counts,
    text_at,
    value_at,
    worse_lines,
    worse_than_odometry,
)
from lirs_validation.record.run_record import read_record, succeeded
from lirs_validation.record.verdict import LIMITS, VerdictLimits, class_counts, stored_verdict
from lirs_validation.report.collision_tables import verdicts_table
from lirs_validation.report.table import Content, MetricSpread, ReportTable
from lirs_validation.sweep.sweep import Sweep
from lirs_validation.sweep.tasks import CollisionTask, read_verdict

EXTRAPOLATED = "†"
SECTIONS: dict[Section, str] = {
    "rtf": "Real-time factor",
    "trajectory": "Trajectory",
    "map": "Map",
    "contacts": "Contacts while mapping",
    "cost": "Cost",
}
"""Sections of the report and their titles."""
SINGLE = {"world", "robot", "mapper"}
"""Fields with columns in the table of single runs, in addition to the seed."""
MOST_NAMED = 12
"""Largest number of groups that a caption names one by one."""
ERROR, ODOMETRY_ERROR = metrics_named((ATE, ODOMETRY_ATE))
CAPTION = (
    "ATE [m], mean over the runs that finished, and verdicts of the runs (docs/results.md); those that were "
    f"not evaluated are not counted. {WORSE_MARK} {WORSE} in at least one run."
)
AS_PUBLISHED, WITHOUT_ATTITUDE = "as published", "without attitude"
FACTS = {"world": "world.name", **{name: f"config.{name}" for name in RUN_AXES}, "status": "status"}
"""Columns before the metrics, and their keys in the record."""
ALWAYS = ("world", "robot", "mapper", "seed", "status")
"""Columns that are always shown."""
DECIDING = ("verdict", *(m.short or m.heading for m in metrics_named((ATE, ODOMETRY_ATE, "map.f1"))))
"""Columns of the table of runs that a narrow screen never hides."""


def failures_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the failed runs with their reasons."""
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


def ended_lines(entries: Sequence[Entry]) -> list[str]:
    """Return a line per run that failed or was stopped, with its reason."""
    fields = {"world", "robot", "mapper", *distinguishing_fields(map(RunGroup.of, entries))}
    lines = []
    for entry in entries:
        if entry["status"] != "ok":
            run = f"{RunGroup.of(entry).label(fields)}, seed {text_at(entry, FACTS['seed'])}"
            failed = "" if succeeded(entry) else " failed"
            lines.append(f"{run}{failed}: {entry.get('reason') or entry['status']}")
    return lines


def summary_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the most important metrics by group, with the number of successful runs."""
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
    """Return means over each group's successful runs, with 95 % intervals over seeds."""
    groups = by_group(entries)
    fields = _fields(groups)
    kept = _existing(metrics, entries)
    headings = (*fields, *(("finished",) if count else ()), *(metric.heading for metric in kept))
    rows = []
    for group, runs in groups.items():
        good = [run for run in runs if succeeded(run)]
        counted = (f"{len(good)} of {len(runs)}",) if count else ()
        rows.append((*group_texts(group, fields), *counted, *(over_runs(metric, good) for metric in kept)))
    caption = _caption(kept, entries)
    if any(isinstance(cell, MetricSpread) and cell.partial for row in rows for cell in row):
        caption += " (n of N): n of the N runs have this value."
    return ReportTable(key, title, caption, headings, tuple(rows), len(fields) + count)


def over_runs(metric: Metric, entries: Sequence[Entry]) -> MetricSpread:
    """Return a metric over runs, without the RTF of concurrent runs."""
    values = [v for e in entries if (v := metric.comparable(e)) is not None]
    stopped = metric.section == "rtf" and any(e["rtf"]["extrapolated"] for e in entries if rtf_counts(e))
    worse = metric.key == ATE and any(map(worse_than_odometry, entries))
    mark = EXTRAPOLATED if stopped else WORSE_MARK if worse else ""
    return MetricSpread(metric, repeats(values), mark, len(entries))


def _caption(metrics: Sequence[Metric], entries: Sequence[Entry]) -> str:
    """Return the caption: statistics, seeds and omitted runs."""
    seeds = {sum(map(succeeded, runs)) for runs in by_group(entries).values()}
    if max(seeds, default=0) <= 1:
        lines = ["One seed: one run's values, without any interval."]
    else:
        lines = ["Mean over seeds ± half width of its 95 % interval (Student's t)."]
        if min(seeds) <= 1:
            lines.append("Without ±: one seed that finished.")
    if any(metric.section == "rtf" for metric in metrics):
        lines += _without_rtf(entries)
        if any(e["rtf"] and e["rtf"]["extrapolated"] for e in entries):
            lines.append(f"{EXTRAPOLATED} extrapolated: some drives were stopped at their wall limit.")
    if any(metric.key == ATE for metric in metrics):
        lines += _worse(entries)
    return " ".join(lines)


def _without_rtf(entries: Sequence[Entry]) -> list[str]:
    """Return one sentence on runs whose RTF is not shown, if any."""
    beside = sum(value_at(e, "rtf.mean") is not None and not rtf_counts(e) for e in entries)
    runs, have = ("run", "has") if beside == 1 else ("runs", "have")
    return [f"{beside} concurrent {runs} {have} no RTF here."] if beside else []


def _worse(entries: Sequence[Entry]) -> list[str]:
    """Return one sentence on groups with runs worse than their odometry, if any."""
    groups = by_group([entry for entry in entries if succeeded(entry)])
    fields = _fields(groups)
    named = []
    for group, runs in groups.items():
        worse = sum(map(worse_than_odometry, runs))
        if worse:
            named.append(f"{group.label(fields)} ({worse} of {len(runs)} run{'s' if len(runs) > 1 else ''})")
    more = f" and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else ""
    return [f"{WORSE_MARK} {WORSE}: {'; '.join(named[:MOST_NAMED])}{more}."] if named else []


def _fields(groups: Iterable[RunGroup]) -> tuple[str, ...]:
    """Return world, mapper and the fields that distinguish the groups."""
    different = {"world", "mapper", *distinguishing_fields(groups)}
    return tuple(field for field in FIELDS if field in different)


def group_texts(group: RunGroup, fields: Sequence[str]) -> tuple[Content, ...]:
    """Return the values of a group's fields as text."""
    values = [group[field] for field in fields]
    return tuple(f"{v:g} s" if isinstance(v, float) else str(v) for v in values)


def _existing(metrics: Sequence[Metric], entries: Sequence[Entry]) -> tuple[Metric, ...]:
    """Return the metrics that at least one record has."""
    return tuple(m for m in metrics if any(m.of(e) is not None for e in entries))


def method_tables(entries: Sequence[Entry]) -> tuple[ReportTable, ...]:
    """Return the tables of methods as published and of mappers without attitude."""
    tables = (_method_table(kind, entries) for kind in (AS_PUBLISHED, WITHOUT_ATTITUDE))
    return tuple(table for table in tables if table.rows)


def _method_table(kind: str, entries: Sequence[Entry]) -> ReportTable:
    groups = by_group(entries)
    aware = [group for group in groups if group["attitude"] == "imu"]
    pairs = {group: runs for group in aware if (runs := _planar_runs(kind, group, groups))}
    fields = [field for field in _fields(pairs) if field != "attitude"]
    rows = []
    for group, planar in pairs.items():
        cells: list[Content] = [*group_texts(group, fields)]
        for runs in (planar, groups[group]):
            cells += (over_runs(ERROR, [e for e in runs if succeeded(e)]), _verdict_counts(runs))
        driven = {entry["seed"]: entry for entry in planar + groups[group] if succeeded(entry)}
        rows.append((*cells, over_runs(ODOMETRY_ERROR, list(driven.values()))))
    columns = (kind, f"verdicts {kind}", "with attitude", "verdicts with attitude", "odometry")
    title = f"{kind.capitalize()}, with attitude, odometry alone"
    return ReportTable(kind.replace(" ", "-"), title, CAPTION, (*fields, *columns), tuple(rows), len(fields))


def _planar_runs(kind: str, group: RunGroup, groups: Mapping[RunGroup, list[Entry]]) -> list[Entry]:
    """Return the planar runs beside a terrain-aware group; methods as published use no attitude."""
    if kind == WITHOUT_ATTITUDE:
        published = group["mapper"].endswith(ORIGINAL)
        return [] if published else groups.get(group.replaced(attitude="none"), [])
    original = group.replaced(mapper=group["mapper"] + ORIGINAL)
    return groups.get(original) or groups.get(original.replaced(attitude="none"), [])


def _verdict_counts(entries: Sequence[Entry]) -> str:
    """Return the verdicts of the evaluated runs as text."""
    kinds = [entry["verdict"]["class"] for entry in entries]
    return class_counts(kind for kind in kinds if kind != "not evaluated") or "not evaluated"


def results_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the runs, failures first, with remarks on failed and inaccurate runs.

    Values that all runs share are in the title, so that the table fits a terminal of 80 characters.
    """
    entries = sorted(entries, key=succeeded)
    shown = {*ALWAYS, *unusual_fields(map(RunGroup.of, entries))}
    facts = [name for name in FACTS if name in shown]
    metrics = [m for m in metrics_selected("runs") if not m.optional or _existing([m], entries)]
    rows = [
        (
            *(text_at(e, FACTS[name]) for name in facts),
            e["verdict"]["class"],
            *(m.formatted(m.comparable(e)) for m in metrics),
        )
        for e in entries
    ]
    table = ReportTable(
        "runs",
        "",
        "\n".join((*ended_lines(entries), *worse_lines(entries), *_without_rtf(entries))),
        (*facts, "verdict", *(metric.short or metric.heading for metric in metrics)),
        tuple(rows),
        len(facts),
        styles=tuple(
            "bold red" if not succeeded(e) else "yellow" if worse_than_odometry(e) else "" for e in entries
        ),
        keep=DECIDING,
    )
    return table.with_common_in_title(RUN_AXES, unnamed=("robot", "mapper"))


def verdict_lines(entries: Sequence[Entry], limits: VerdictLimits = LIMITS) -> list[str]:
    """Return the verdicts by group: a sentence of one run, counts of more."""
    groups = by_group(entries)
    named = ("world", "robot", "mapper")  # a sentence names these three
    varied = tuple(name for name in _fields(groups) if name not in named)
    lines = []
    for group, runs in groups.items():
        verdicts = [stored_verdict(run, limits) for run in runs]
        fields = varied if len(runs) == 1 else (*named, *varied)
        label = f", {group.label(fields)}" if fields else ""
        text = class_counts(verdict.kind for verdict in verdicts) if len(runs) > 1 else str(verdicts[0])
        lines.append(f"verdict{label}: {text}")
    return lines


def verdicts_by_method(entries: Sequence[Entry]) -> ReportTable:
    """Return the verdicts by group; of one run, with its sentence."""
    groups = by_group(entries)
    fields = _fields(groups)
    rows = []
    for group, runs in groups.items():
        verdicts = [entry["verdict"] for entry in runs]
        first = next((v for v in verdicts if v["class"] != "works"), verdicts[0])
        counts = class_counts(v["class"] for v in verdicts)
        rows.append((*group_texts(group, fields), counts, first["sentence"]))
    caption = "Class of each run (docs/results.md), and the sentence of the first that does not work, if any."
    headings = (*fields, "verdict", "sentence")
    return ReportTable("verdicts", "Verdict", caption, headings, tuple(rows), len(headings))


def sweep_tables(sweep: Sweep) -> Iterator[RenderableType]:
    """Yield tables of finished tasks: runs or groups, methods as published, verdicts."""
    finished = [found for found in sweep.tasks if found.name in sweep.outcomes]
    checks = [check for check in finished if isinstance(check, CollisionTask)]
    entries = [read_record(sweep.out / run.name) for run in finished if run not in checks]
    groups = by_group(entries)
    if len(groups) < len(entries) or not set(distinguishing_fields(groups)) <= SINGLE:
        if lines := ended_lines(entries):
            yield Text("\n".join(lines), style="bold red")
        yield replace(summary_table(entries), title="")
    elif entries:
        yield results_table(entries)
    yield from method_tables(entries)
    verdicts = [read_verdict(sweep.out / c.name) for c in checks if sweep.outcomes[c.name].succeeded]
    if verdicts:
        yield verdicts_table(verdicts)
