"""The contents of a report, before it is HTML, Markdown or CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lirs_validation.analysis.groups import by_group
from lirs_validation.analysis.recorded import recorded_config
from lirs_validation.analysis.result_folders import ResultFolder, RunFolder
from lirs_validation.collision.files import failed as failed_checks
from lirs_validation.collision.validation import CollisionVerdict
from lirs_validation.record.catalog import Section
from lirs_validation.record.formatting import NOTHING, Entry
from lirs_validation.record.run_record import succeeded
from lirs_validation.report.command_line import command_of
from lirs_validation.report.paper.findings import Finding, findings
from lirs_validation.report.paper.tables import paper_tables
from lirs_validation.report.tables.metric_tables import (
    SECTIONS,
    failures_table,
    section_by_group,
    section_by_run,
    summary_table,
)
from lirs_validation.report.tables.table import ReportTable
from lirs_wct.errors import WctError


@dataclass(frozen=True)
class Paper:
    """The paper's tables beside ours, and its findings."""

    intro: str
    tables: tuple[ReportTable, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Origin:
    """Runs that the same software made on the same machine."""

    runs: int
    versions: str
    machine: str


@dataclass(frozen=True, kw_only=True)
class Report:
    """The contents of a report on a folder of results.

    Attributes:
        runs: in the order in which they were asked for.
        sections: key, table by group and table by run of each section of metrics.
        checks: collision validations that passed, and all.
        paper: only of the paper's suite.
        seeds: fewest and most seeds that succeeded, over the groups; (0, 0) where none did.
    """

    title: str
    subtitle: str
    runs: tuple[RunFolder, ...]
    failures: ReportTable
    checks_failed: ReportTable
    skipped: ReportTable
    summary: ReportTable
    sections: tuple[tuple[Section, ReportTable, ReportTable], ...]
    collisions: ReportTable
    checks: tuple[int, int]
    paper: Paper | None
    command: str
    origins: tuple[Origin, ...]
    commands: ReportTable
    seeds: tuple[int, int]

    @property
    def entries(self) -> list[Entry]:
        """The records."""
        return [run.entry for run in self.runs]

    @property
    def tables(self) -> list[ReportTable]:
        """Every table that has rows."""
        tables = [self.failures, self.checks_failed, self.skipped, self.summary]
        tables += self.paper.tables if self.paper else ()
        tables += [table for _, groups, runs in self.sections for table in (groups, runs)]
        return [table for table in (*tables, self.collisions, self.commands) if table.rows]


def report_of(results: ResultFolder) -> Report:
    """Return the contents of a report on a folder of results."""
    manifest = results.manifest or {}
    runs = _ordered(results.runs, manifest)
    entries = [run.entry for run in runs]
    suite = manifest.get("suite")
    seeds = _seeds(entries)
    failed = [verdict for verdict in results.collisions if not verdict.passed]
    asked = len(manifest.get("cells", ())) or len(entries) + len(results.collisions)
    missing = asked - len(entries) - len(results.collisions) - len(results.broken)
    title = f"Validation runs in {results.root.name}"
    return Report(
        title="The paper's experiment, repeated" if suite == "paper" else title,
        subtitle=_subtitle(entries, seeds, missing),
        runs=runs,
        failures=failures_table(entries),
        checks_failed=_checks_failed(failed, results.broken),
        skipped=ReportTable(
            "skipped", "Not read", "Folders that are damaged or of another version: in no table below.",
            ("folder", "reason"), results.skipped, 2,
        ),
        summary=summary_table(entries),
        sections=tuple(
            (section, groups, section_by_run(section, entries))
            for section in SECTIONS
            if (groups := section_by_group(section, entries)).rows
            and len(groups.headings) > groups.text_columns
        ),
        collisions=_collision_table(results.collisions),
        checks=(len(results.collisions) - len(failed), len(results.collisions) + len(results.broken)),
        paper=_paper(entries) if suite == "paper" else None,
        command=str(manifest.get("command", "")),
        origins=_origins(entries),
        commands=_commands(entries),
        seeds=seeds,
    )  # fmt: skip


def _ordered(runs: Sequence[RunFolder], manifest: Entry) -> tuple[RunFolder, ...]:
    place = {cell.get("name"): k for k, cell in enumerate(manifest.get("cells", ()))}
    return tuple(sorted(runs, key=lambda run: place.get(run.entry["name"], len(place))))


def _seeds(entries: Sequence[Entry]) -> tuple[int, int]:
    """Return the fewest and the most seeds that succeeded, over the groups in which one did."""
    counts = [len({e["seed"] for e in runs if succeeded(e)}) for runs in by_group(entries).values()]
    kept = [count for count in counts if count] or [0]
    return min(kept), max(kept)


def seeds_text(seeds: tuple[int, int]) -> str:
    """Return fewest and most seeds as text."""
    low, high = seeds
    return str(high) if low == high else f"{low} to {high}"


def _subtitle(entries: Sequence[Entry], seeds: tuple[int, int], missing: int) -> str:
    parts = [f"{len(entries)} runs"]
    parts.append("one seed: nothing is said of chance" if seeds[1] <= 1 else f"{seeds_text(seeds)} seeds")
    if missing > 0:
        parts.append(f"{missing} that were asked for are not there (yet)")
    return "; ".join(parts) + "."


def _paper(entries: Sequence[Entry]) -> Paper:
    intro = (
        "LIRS-WCT's paper compared SLAM methods on three terrains, each as a heightmap and as a solid model, "
        "by the real-time factor of a Husky. Here the same in MuJoCo, the paper's values beside it."
    )
    return Paper(intro, paper_tables(entries), findings(entries))


def _checks_failed(failed: Sequence[CollisionVerdict], broken: Sequence[tuple[str, str]]) -> ReportTable:
    rows = [(v.world, v.robot, line) for v in failed for line in failed_checks(v)]
    rows += [(name, NOTHING, reason) for name, reason in broken]
    return ReportTable(
        "checks-failed",
        "Collision checks over their limits",
        "",
        ("world", "robot", "figure"),
        tuple(rows),
        3,
    )


def _collision_table(verdicts: Sequence[CollisionVerdict]) -> ReportTable:
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


def _origins(entries: Sequence[Entry]) -> tuple[Origin, ...]:
    found: dict[tuple[str, str], int] = {}
    for entry in entries:
        versions = ", ".join(f"{name} {version}" for name, version in entry["versions"].items())
        machine = entry["machine"]
        text = f"{machine['processor']}, {machine['cores']} cores, {machine['system']}"
        found[(versions, text)] = found.get((versions, text), 0) + 1
    return tuple(Origin(n, versions, machine) for (versions, machine), n in found.items())


def _commands(entries: Sequence[Entry]) -> ReportTable:
    rows = []
    for entry in entries:
        try:
            command = command_of(recorded_config(entry))
        except WctError as error:
            command = f"not known: {error}"
        rows.append((str(entry["name"]), command))
    return ReportTable("commands", "The command of every run", "", ("run", "command"), tuple(rows), 2)
