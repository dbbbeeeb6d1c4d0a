"""Tables of collision validations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from lirs_validation.collision.validation import Check, CollisionVerdict
from lirs_validation.record.metric_catalog import NOTHING
from lirs_validation.report.table import ReportTable

COLUMNS: tuple[tuple[str, Callable[[CollisionVerdict], str]], ...] = (
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


def verdicts_table(verdicts: Sequence[CollisionVerdict]) -> ReportTable:
    """Return the verdicts for the screen, with a line per metric over its limit.

    Values that all verdicts share are in the title, so that the table fits a terminal of 80 characters.
    """
    lines = "\n".join(line for verdict in _failures_first(verdicts) for line in over_limits(verdict))
    table = replace(collision_table(verdicts), title="", caption=lines)
    return table.with_common_in_title(("robot", "terrain", "seed"))


def collision_table(verdicts: Sequence[CollisionVerdict]) -> ReportTable:
    """Return all metrics of the verdicts, failures first."""
    ordered = _failures_first(verdicts)
    caption = "Limits are explained in docs/results.md; tip-overs and stuck time have none."
    headings = tuple(heading for heading, _ in COLUMNS)
    rows = tuple(tuple(text(verdict) for _, text in COLUMNS) for verdict in ordered)
    styles = tuple("" if verdict.passed else "bold red" for verdict in ordered)
    return ReportTable("collisions", "Collision validation", caption, headings, rows, 5, styles=styles)


def _failures_first(verdicts: Sequence[CollisionVerdict]) -> list[CollisionVerdict]:
    return sorted(verdicts, key=lambda verdict: verdict.passed)


def _text(value: float | None, digits: int = 0) -> str:
    return NOTHING if value is None else f"{value:.{digits}f}"


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
    title, headings = "Collision checks over their limits", ("world", "robot", "figure")
    return ReportTable("checks-failed", title, "", headings, tuple(rows), 3)
