"""Tables of runs, groups of runs, failures, methods, collision validations and commands."""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from operator import attrgetter
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from lirs_validation.analysis.compare import ORIGINAL, compare, least_effect, repeats
from lirs_validation.analysis.results import recorded_config
from lirs_validation.collision.validation import CollisionVerdict
from lirs_validation.config import RUN_AXES, WORLD_FLAGS, RunConfig
from lirs_validation.metrics.trajectory import ErrorSpread
from lirs_validation.record.metric_catalog import (
    ATE,
    NOTHING,
    ODOMETRY_ATE,
    WORSE,
    WORSE_MARK,
    Entry,
    Metric,
    Section,
    metrics_in,
    metrics_named,
    metrics_selected,
    other_load,
    rtf_counts,
    text_at,
    value_at,
    worse_lines,
    worse_than_odometry,
)
from lirs_validation.record.run_record import (
    FIELDS,
    RunGroup,
    by_group,
    distinguishing_fields,
    read_record,
    succeeded,
    unusual_fields,
)
from lirs_validation.record.verdict import LEADS, LIMITS, VerdictLimits, class_counts, stored_verdict
from lirs_validation.report.table import Content, MetricSpread, ReportTable
from lirs_validation.sweep.sweep import Sweep
from lirs_validation.sweep.tasks import CollisionTask, read_verdict
from lirs_wct import Pose2, WctError
from lirs_wct.option import changed, declared

EXTRAPOLATED = "†"
SECTIONS: dict[Section, str] = {
    "rtf": "Real-time factor",
    "trajectory": "Trajectory",
    "map": "Map",
    "contacts": "Contacts while mapping",
    "cost": "Cost",
}
"""Sections of the report and their titles."""
RUN_COLUMNS = {"world", "robot", "mapper"}
"""Fields with columns in the table of single runs, in addition to the seed."""
MAX_NAMED = 12
"""Largest number of groups that a caption, or lines of verdicts, name one by one."""
DRIVEN, ERROR, ODOMETRY_ERROR = metrics_named(("trajectory.length", ATE, ODOMETRY_ATE))
CAPTION = (
    "ATE [m], mean over the runs that finished, and verdicts of the runs (docs/results.md); those that were "
    f"not evaluated are not counted. {WORSE_MARK} {WORSE} in at least one run."
)
AS_PUBLISHED, WITHOUT_ATTITUDE = "as published", "without attitude"
FACTS = {"world": "world.name", **{name: f"config.{name}" for name in RUN_AXES}, "status": "status"}
"""Columns before the metrics, and their keys in the record."""
FIXED_COLUMNS = ("world", "robot", "mapper", "seed", "status")
"""Columns that are always shown."""

QUALITY = tuple(metric for metric in metrics_selected("compared") if metric.section in ("trajectory", "map"))
"""Figures that stored runs are compared by; times depend on the machine."""
LEAST_VERDICTS, CLEAR = 3, 2.0
"""Fewest seeds whose verdicts are all worse; change that seeds should show, in spreads over the seeds."""
COLLISION_COLUMNS: tuple[tuple[str, Callable[[CollisionVerdict], str]], ...] = (
    ("world", lambda v: v.world),
    ("robot", lambda v: v.robot),
    ("terrain", lambda v: v.terrain),
    ("seed", lambda v: str(v.seed)),
    ("verdict", lambda v: "pass" if v.passed else "FAIL"),
    ("penetration, 99.9 % [mm]", lambda v: f"{1e3 * v.penetration_p999:.2f}"),
    ("peak [mm]", lambda v: f"{1e3 * v.penetration_peak:.2f}"),
    ("its limit [mm]", lambda v: f"{1e3 * v.penetration_limit:.1f}"),
    ("steps inside", lambda v: str(v.inside_steps)),
    ("energy gained [J]", lambda v: f"{v.energy_gain:.2f}"),
    ("its limit [J]", lambda v: f"{v.energy_limit:.2f}"),
    ("peak force [N]", lambda v: f"{v.force_peak:.0f}"),
    ("mean force [N]", lambda v: f"{v.force_mean:.0f}"),
    ("slope [deg]", lambda v: _text(v.slope)),
    ("slid [m]", lambda v: _text(v.slid, 2)),
    ("climbed", lambda v: _text(v.climbed, 2)),
    ("tip-overs", lambda v: str(v.tip_overs)),
    ("stuck [s]", lambda v: f"{v.stuck:.1f}"),
    ("driven [m]", lambda v: f"{v.driven:.0f}"),
)
"""Headings and contents; the first five columns hold text."""
FAILED_FIRST = attrgetter("passed")
"""Sorting key of collision verdicts."""


def failures_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the failed runs with their reasons."""
    failed = [entry for entry in entries if not succeeded(entry)]
    groups = [RunGroup.of(e) for e in entries]
    fields = tuple(dict.fromkeys(("world", "robot", "mapper", *unusual_fields(groups))))
    rows = [(*run_texts(e, fields), str(e["reason"] or e["status"]), str(e["name"])) for e in failed]
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


def section_by_run(section: Section, entries: Sequence[Entry]) -> ReportTable:
    """Return a section's metrics, run by run."""
    fields = _fields(by_group(entries))
    kept = _existing(metrics_in(section), entries)
    headings = (*fields, "seed", "status", *(metric.heading for metric in kept))
    rows = [(*run_texts(e, fields), *(over_runs(m, [e]) for m in kept)) for e in entries]
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
    caption = _caption(metrics, entries)
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
        lines += without_rtf(entries)
        if any(e["rtf"] and e["rtf"]["extrapolated"] for e in entries):
            lines.append(f"{EXTRAPOLATED} extrapolated: some drives were stopped at their wall limit.")
    if any(metric.key == ATE for metric in metrics):
        lines += _worse_than_odometry(entries)
    return " ".join(lines)


def without_rtf(entries: Sequence[Entry]) -> list[str]:
    """Return one sentence on runs whose RTF is not shown, if any."""
    loads = [load for e in entries if value_at(e, "rtf.mean") is not None and (load := other_load(e))]
    of = f" of {len(loads)} run{'s' if len(loads) > 1 else ''}" if len(loads) < len(entries) else ""
    return [f"RTF{of} not given: {' and '.join(sorted(set(loads)))} used the processor."] if loads else []


def _worse_than_odometry(entries: Sequence[Entry]) -> list[str]:
    """Return one sentence on groups with runs worse than their odometry, if any."""
    groups = by_group([entry for entry in entries if succeeded(entry)])
    fields = _fields(groups)
    named = []
    for group, runs in groups.items():
        worse = sum(map(worse_than_odometry, runs))
        if worse:
            named.append(f"{group.label(fields)} ({worse} of {len(runs)} run{'s' if len(runs) > 1 else ''})")
    more = f" and {len(named) - MAX_NAMED} more" if len(named) > MAX_NAMED else ""
    return [f"{WORSE_MARK} {WORSE}: {'; '.join(named[:MAX_NAMED])}{more}."] if named else []


def _fields(groups: Iterable[RunGroup]) -> tuple[str, ...]:
    """Return world, mapper and the fields that distinguish the groups."""
    different = {"world", "mapper", *distinguishing_fields(groups)}
    return tuple(field for field in FIELDS if field in different)


def group_texts(group: RunGroup, fields: Sequence[str]) -> tuple[Content, ...]:
    """Return the values of a group's fields as text."""
    values = [group[field] for field in fields]
    return tuple(f"{v:g} s" if isinstance(v, float) else str(v) for v in values)


def run_texts(entry: Entry, fields: Sequence[str]) -> tuple[Content, ...]:
    """Return the fields of a run's group, its seed and its status as text."""
    return (*group_texts(RunGroup.of(entry), fields), str(entry["seed"]), str(entry["status"]))


def _existing(metrics: Sequence[Metric], entries: Sequence[Entry]) -> tuple[Metric, ...]:
    """Return the metrics that at least one record has."""
    return tuple(m for m in metrics if any(m.comparable(e) is not None for e in entries))


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
            kinds = [run["verdict"]["class"] for run in runs]
            evaluated = class_counts(kind for kind in kinds if kind != "not evaluated")
            cells += (over_runs(ERROR, list(filter(succeeded, runs))), evaluated or "not evaluated")
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


def results_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the runs, failures first, with remarks on failed and inaccurate runs.

    Values that all runs share are in the title, so that the table fits a terminal of 80 characters.
    """
    entries = sorted(entries, key=succeeded)
    shown = {*FIXED_COLUMNS, *unusual_fields(map(RunGroup.of, entries))}
    facts = [name for name in FACTS if name in shown]
    metrics = _existing(metrics_selected("runs"), entries)
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
        "\n".join((*ended_lines(entries), *worse_lines(entries), *without_rtf(entries))),
        (*facts, "verdict", *(metric.short or metric.heading for metric in metrics)),
        tuple(rows),
        len(facts),
        styles=tuple(
            "bold red" if not succeeded(e) else "yellow" if worse_than_odometry(e) else "" for e in entries
        ),
    )
    return table.with_common_in_title(("world", *RUN_AXES), unnamed=("world", "robot", "mapper"))


def verdict_lines(entries: Sequence[Entry], limits: VerdictLimits = LIMITS) -> list[str]:
    """Return the verdicts by group, or by mapper of more than `MAX_NAMED` groups."""
    groups = by_group(entries)
    named = ("world", "robot", "mapper")  # a sentence names these three
    varied = tuple(name for name in _fields(groups) if name not in named)
    lines, kinds = [], defaultdict[str, list[str]](list)
    for group, runs in groups.items():
        verdicts = [stored_verdict(run, limits) for run in runs]
        fields = varied if len(runs) == 1 else (*named, *varied)
        label = f", {group.label(fields)}" if fields else ""
        text = class_counts(verdict.kind for verdict in verdicts) if len(runs) > 1 else str(verdicts[0])
        lines.append(f"verdict{label}: {text}")
        kinds[group["mapper"]] += [verdict.kind for verdict in verdicts]
    by_mapper = [f"verdict, {mapper}: {class_counts(found)}" for mapper, found in kinds.items()]
    return lines if len(lines) <= MAX_NAMED else by_mapper


def baseline_lines(
    stored: Sequence[Entry], entries: Sequence[Entry], limits: VerdictLimits, accepted: Collection[str]
) -> tuple[list[str], list[str]]:
    """Return lines on what is significantly worse, and on how well this is known.

    Changes that the figures' digits do not show are left out.
    """
    found, order, lead = compare(stored, entries, QUALITY), list(LEADS), "worse than the baseline"
    tested = [d for d in found.differences if d.metric.tested]
    worse = [
        f"{lead}: {d.metric.name} of {_method(d.group)}: {text(d.a)} -> "
        f"{f'{text(d.b)} {d.metric.unit}'.rstrip()} ({d.pairs} pairs, p = {d.p_corrected:.1g})"
        for d in tested
        if d.significant and (d.difference > 0) == (d.metric.better == "less")
        if (text := d.metric.formatted)(d.a) != text(d.b)
    ]
    for group, results in found.common.items():
        a, b = ({run["seed"]: stored_verdict(run, limits).kind for run in runs} for runs in results)
        kinds = [(a[seed], b[seed]) for seed in a if seed in b]
        fell = [order.index(now) < order.index(before) and now not in accepted for before, now in kinds]
        if len(kinds) >= LEAST_VERDICTS and all(fell):
            before, now = map(class_counts, zip(*kinds, strict=True))
            worse.append(f"{lead}: verdict of {_method(group)}: {before} -> {now}")
    notes = [f"not in the baseline: {_method(group)}" for group in found.only_b]
    pairs, tests = min((d.pairs for d in tested), default=0), len(tested)
    if pairs and (least := least_effect(pairs, tests)) > CLEAR:
        needed = next(n for n in count(pairs) if least_effect(n, tests) <= CLEAR)
        above = f"only changes above {least:.0f} times their spread over the seeds are"
        line = f"{pairs} pairs of runs: {above}" if pairs > 1 else "1 pair of runs: no change is"
        notes.append(f"{line} significant; {needed} seeds find changes of {CLEAR:g} times their spread")
    return worse, notes if worse else [*notes, f"none of {tests} figures is significantly worse"]


def _method(group: RunGroup) -> str:
    """Return mapper and place of a group as in a sentence."""
    return f"{group['mapper']} on {group.label({'world', 'robot', *unusual_fields([group])} - {'mapper'})}"


def verdicts_by_method(entries: Sequence[Entry]) -> ReportTable:
    """Return the verdicts by group, with the spread of several runs and a sentence."""
    groups = by_group(entries)
    fields = _fields(groups)
    rows = []
    for group, runs in groups.items():
        first = next((run for run in runs if run["verdict"]["class"] != "works"), runs[0])
        counts, sentence = class_counts(run["verdict"]["class"] for run in runs), first["verdict"]["sentence"]
        if len(runs) > 1:
            sentence = f"{spread_sentence(map(path_result, runs))} Seed {first['seed']}: {sentence}".lstrip()
        rows.append((*group_texts(group, fields), counts, sentence))
    caption = "Class of each run (docs/results.md), and the sentence of the first that does not work, if any."
    headings = (*fields, "verdict", "sentence")
    return ReportTable("verdicts", "Verdict", caption, headings, tuple(rows), len(headings))


PathResult = tuple[str, float | None, float | None]
"""Class of a run's verdict, its path error and driven distance, meters; None of a failed run."""


def path_result(entry: Entry) -> PathResult:
    """Return class, path error and distance of a run's record."""
    kind: str = entry["verdict"]["class"]
    error, distance = (None if kind == "failed" else value_at(entry, key) for key in (ATE, DRIVEN.key))
    return kind, error, distance


def spread_sentence(results: Iterable[PathResult]) -> str:
    """Return the interval of the evaluated runs' path errors; empty without one."""
    errors = [(error, distance) for kind, error, distance in results if kind != "not evaluated"]
    spread = ErrorSpread.of(error for error, _ in errors)
    if spread is None:
        return ""
    driven = DRIVEN.text(
        median(length for error, length in errors if error is not None and length is not None)
    )
    if spread.total == 1:
        return f"In this drive the path error is {ERROR.text(spread.low)} after {driven}."
    low, high = ERROR.formatted(spread.low), ERROR.text(spread.high)
    return f"In {spread.count} drives the path error is between {low} and {high} after {driven}."


def sweep_tables(sweep: Sweep) -> Iterator[RenderableType]:
    """Yield tables of finished tasks: runs or groups, methods as published, verdicts."""
    finished = [found for found in sweep.tasks if found.name in sweep.outcomes]
    checks = [check for check in finished if isinstance(check, CollisionTask)]
    entries = [read_record(sweep.out / run.name) for run in finished if run not in checks]
    groups = by_group(entries)
    if len(groups) < len(entries) or not set(distinguishing_fields(groups)) <= RUN_COLUMNS:
        if lines := ended_lines(entries):
            yield Text("\n".join(lines), style="bold red")
        yield replace(summary_table(entries), title="")
    elif entries:
        yield results_table(entries)
    yield from method_tables(entries)
    verdicts = [read_verdict(sweep.out / c.name) for c in checks if sweep.outcomes[c.name].succeeded]
    if verdicts:
        yield verdicts_table(verdicts)


def verdicts_table(verdicts: Sequence[CollisionVerdict]) -> ReportTable:
    """Return the verdicts for the screen, with a line per metric over its limit.

    Values that all verdicts share are in the title, so that the table fits a terminal of 80 characters.
    """
    lines = [line for verdict in sorted(verdicts, key=FAILED_FIRST) for line in over_limits(verdict)]
    table = replace(collision_table(verdicts), title="", caption="\n".join(lines))
    return table.with_common_in_title(("robot", "terrain", "seed"))


def collision_table(verdicts: Sequence[CollisionVerdict]) -> ReportTable:
    """Return all metrics of the verdicts, failures first."""
    ordered = sorted(verdicts, key=FAILED_FIRST)
    caption = "Limits are explained in docs/results.md; tip-overs and stuck time have none."
    headings = tuple(heading for heading, _ in COLLISION_COLUMNS)
    rows = tuple(tuple(text(verdict) for _, text in COLLISION_COLUMNS) for verdict in ordered)
    styles = tuple("" if verdict.passed else "bold red" for verdict in ordered)
    return ReportTable("collisions", "Collision validation", caption, headings, rows, 5, styles=styles)


def _text(value: float | None, digits: int = 0) -> str:
    return NOTHING if value is None else f"{value:.{digits}f}"


def over_limits(verdict: CollisionVerdict) -> list[str]:
    """Return a line for each metric over its limit."""
    lines = []
    for check in verdict.checks:
        unit = f" {check.unit}" if check.unit else ""
        limit = "at least" if check.least else "at most"
        text = f"{check.name} {check.value:.3g}{unit}, legal: {limit} {check.limit:.3g}{unit}"
        text = verdict.diverged if check.name == "diverged" else text
        if not check.passed:
            lines.append(f"{verdict.world}, {verdict.robot}, {verdict.terrain}, seed {verdict.seed}: {text}")
    return lines


def checks_failed_table(failed: Sequence[CollisionVerdict], broken: Sequence[tuple[str, str]]) -> ReportTable:
    """Return the exceeded limits, and validations without a result."""
    rows = [(v.world, v.robot, line) for v in failed for line in over_limits(v)]
    rows += [(name, NOTHING, reason) for name, reason in broken]
    title, headings = "Collision checks over their limits", ("world", "robot", "figure")
    return ReportTable("checks-failed", title, "", headings, tuple(rows), 3)


def commands_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the command that repeats each run."""
    rows = []
    for entry in entries:
        try:
            command = command_of(recorded_config(entry))
        except WctError as error:
            command = f"not known: {error}"
        rows.append((str(entry["name"]), command))
    return ReportTable("commands", "The command of every run", "", ("run", "command"), tuple(rows), 2)


def command_of(config: RunConfig) -> str:
    """Return the command line that repeats a run; defaults are left out."""
    words = ["lirs-wct", "validate", config.source]
    words += ["--robot", config.robot, "--mapper", config.mapper, "--seed", str(config.seed)]
    for options in (config, config.build):
        for name, value in changed(options).items():
            if name not in ("robot", "mapper", "seed"):
                has_flag = None if options is config else name in WORLD_FLAGS
                words += declared(type(options))[name].arguments(_option_text(value), has_flag)
    return shlex.join(words)


def _option_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Pose2):
        value = tuple(value.as_array().tolist())
    if isinstance(value, tuple):
        return ",".join(map(_option_text, value))
    if isinstance(value, (str, Path)):
        return str(value)
    short = f"{value:.12g}"
    return short if float(short) == value else repr(value)
