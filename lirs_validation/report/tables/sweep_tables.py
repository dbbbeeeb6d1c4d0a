"""Tables of a sweep and of collision validations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from lirs_validation.analysis.groups import by_group, distinguishing_fields
from lirs_validation.collision.validation import Check, CollisionVerdict
from lirs_validation.record.formatting import NOTHING
from lirs_validation.record.run_record import read_record
from lirs_validation.report.tables.run_tables import (
    failure_lines,
    method_tables,
    results_table,
    summary_table,
)
from lirs_validation.report.tables.table import FittedTable, ReportTable
from lirs_validation.sweep.collision_experiment import CollisionExperiment, read_verdict
from lirs_validation.sweep.sweep import Sweep

COLUMNS: tuple[tuple[str, Callable[[CollisionVerdict], str]], ...] = (
    ("world", lambda v: v.world),
    ("robot", lambda v: v.robot),
    ("terrain", lambda v: v.terrain),
    ("seed", lambda v: str(v.seed)),
    ("", lambda v: "ok" if v.passed else "FAIL"),
    ("99.9 % [mm]", lambda v: f"{1e3 * v.penetration_p999:.1f}"),
    ("peak [mm]", lambda v: f"{1e3 * v.penetration_peak:.1f}"),
    ("legal [mm]", lambda v: f"{1e3 * v.penetration_limit:.0f}"),
    ("gain [%]", lambda v: f"{100 * v.energy_gain / v.energy_limit:.0f}"),
    ("force [N]", lambda v: f"{v.force_peak:.0f}"),
    ("slope [deg]", lambda v: "-" if v.slope is None else f"{v.slope:.0f}"),
    ("tips", lambda v: str(v.tip_overs)),
)
"""Heading and content; the gained energy is a share of its limit."""
COMMON = ("robot", "terrain", "seed")
"""Columns whose common value moves into the title, so that the table fits 80 characters."""
TEXTS = ("world", *COMMON, "")
"""Columns of text; the last one is the verdict."""
FIELDS = {"world", "robot", "mapper"}
"""Fields with columns in the table of single runs, in addition to the seed."""


def verdicts_table(verdicts: Sequence[CollisionVerdict]) -> FittedTable:
    """Return the verdicts, failures first, with a line per metric over its limit."""
    ordered = sorted(verdicts, key=lambda verdict: verdict.passed)
    common = [c for c in COLUMNS if c[0] in COMMON and len({c[1](v) for v in ordered}) == 1]
    columns = [c for c in COLUMNS if c not in common]
    table = ReportTable(
        "collisions",
        "",
        "\n".join(line for verdict in ordered for line in over_limits(verdict)),
        tuple(heading for heading, _ in columns),
        tuple(tuple(text(verdict) for _, text in columns) for verdict in ordered),
        sum(heading in TEXTS for heading, _ in columns),
    )
    title = ", ".join(f"{name} {text(ordered[0])}" for name, text in common)
    return FittedTable(table, title=title, styles=["" if v.passed else "bold red" for v in ordered])


def over_limits(verdict: CollisionVerdict) -> list[str]:
    """Return a line for each metric over its limit."""
    who = f"{verdict.world}, {verdict.robot}, {verdict.terrain}, seed {verdict.seed}"
    return [
        f"{who}: {verdict.diverged if check.name == 'diverged' else _over(check)}"
        for check in verdict.checks
        if not check.passed
    ]


def _over(check: Check) -> str:
    unit = f" {check.unit}" if check.unit else ""
    limit = "at least" if check.least else "at most"
    return f"{check.name} {check.value:.3g}{unit}, legal: {limit} {check.limit:.3g}{unit}"


def checks_failed_table(failed: Sequence[CollisionVerdict], broken: Sequence[tuple[str, str]]) -> ReportTable:
    """Return the exceeded limits, and validations without a result."""
    rows = [(v.world, v.robot, line) for v in failed for line in over_limits(v)]
    rows += [(name, NOTHING, reason) for name, reason in broken]
    return ReportTable(
        "checks-failed",
        "Collision checks over their limits",
        "",
        ("world", "robot", "figure"),
        tuple(rows),
        3,
    )


def collision_table(verdicts: Sequence[CollisionVerdict]) -> ReportTable:
    """Return all verdicts, failures first."""
    rows = []
    for v in sorted(verdicts, key=lambda verdict: verdict.passed):
        slope = NOTHING if v.slope is None else f"{v.slope:.0f}"
        slid, climbed = (NOTHING if x is None else f"{x:.2f}" for x in (v.slid, v.climbed))
        rows.append((
            v.world, v.robot, v.terrain, "pass" if v.passed else "FAIL", f"{1e3 * v.penetration_p999:.2f}",
            f"{1e3 * v.penetration_peak:.2f}", f"{1e3 * v.penetration_limit:.1f}", str(v.inside_steps),
            f"{v.energy_gain:.2f}", f"{v.energy_limit:.2f}", f"{v.force_peak:.0f}", f"{v.force_mean:.0f}",
            slope, slid, climbed, str(v.tip_overs), f"{v.stuck:.1f}", f"{v.driven:.0f}",
        ))  # fmt: skip
    headings = (
        "world", "robot", "terrain", "verdict", "penetration, 99.9 % [mm]", "peak [mm]", "its limit [mm]",
        "steps inside", "energy gained [J]", "its limit [J]", "peak force [N]", "mean force [N]",
        "slope [deg]", "slid [m]", "climbed", "tip-overs", "stuck [s]", "driven [m]",
    )  # fmt: skip
    caption = "Limits are explained in docs/results.md; tip-overs and stuck time have none."
    return ReportTable("collisions", "Collision validation", caption, headings, tuple(rows), 4)


def sweep_tables(sweep: Sweep) -> Iterator[RenderableType]:
    """Yield tables of finished experiments: runs or groups, methods as published, verdicts."""
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
    """Return a record without its series, to save memory."""
    entry = read_record(sweep.out / name)
    entry["rtf"].pop("series", None)
    return entry
