"""Contents of a report, independent of HTML, Markdown or CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lirs_validation.analysis.groups import by_group
from lirs_validation.analysis.result_folders import ResultFolder, RunFolder
from lirs_validation.record.formatting import Entry
from lirs_validation.record.metric_catalog import Section
from lirs_validation.record.run_record import succeeded
from lirs_validation.report.collision_tables import checks_failed_table, collision_table
from lirs_validation.report.paper import Finding, findings, paper_tables
from lirs_validation.report.provenance import Origin, commands_table, origins_of
from lirs_validation.report.run_tables import (
    SECTIONS,
    failures_table,
    method_tables,
    section_by_group,
    section_by_run,
    summary_table,
    verdicts_by_method,
)
from lirs_validation.report.table import ReportTable


@dataclass(frozen=True)
class Paper:
    """The paper's tables beside ours, and its findings."""

    intro: str
    tables: tuple[ReportTable, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class Report:
    """The contents of a report on a folder of results.

    Attributes:
        runs: runs in the order of the sweep.
        sections: key, table by group and table by run of each section of metrics.
        checks: collision validations that passed, and all.
        methods: comparison of methods as published, or without attitude, with terrain-aware ones.
        paper: comparison with the paper; None except for the paper's suite.
        seeds: fewest and most successful seeds of a group; (0, 0) without any.
    """

    title: str
    subtitle: str
    runs: tuple[RunFolder, ...]
    verdicts: ReportTable
    failures: ReportTable
    checks_failed: ReportTable
    skipped: ReportTable
    summary: ReportTable
    sections: tuple[tuple[Section, ReportTable, ReportTable], ...]
    collisions: ReportTable
    checks: tuple[int, int]
    methods: tuple[ReportTable, ...]
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
        tables = [self.verdicts, self.failures, self.checks_failed, self.skipped, self.summary, *self.methods]
        tables += self.paper.tables if self.paper else ()
        tables += [table for _, groups, runs in self.sections for table in (groups, runs)]
        return [table for table in (*tables, self.collisions, self.commands) if table.rows]


def report_of(results: ResultFolder) -> Report:
    """Return the contents of a report on a folder of results."""
    manifest = results.manifest or {}
    runs = _order_runs(results.runs, manifest)
    entries = [run.entry for run in runs]
    suite = manifest.get("suite")
    seeds = _seeds(entries)
    failed = [verdict for verdict in results.collisions if not verdict.passed]
    title = f"Validation runs in {results.root.name}"
    return Report(
        title="The paper's experiment, repeated" if suite == "paper" else title,
        subtitle=_subtitle(entries, seeds, _missing(results, manifest)),
        runs=runs,
        verdicts=verdicts_by_method(entries),
        failures=failures_table(entries),
        checks_failed=checks_failed_table(failed, results.broken),
        skipped=_skipped_table(results),
        summary=summary_table(entries),
        sections=_sections(entries),
        collisions=collision_table(results.collisions),
        checks=(len(results.collisions) - len(failed), len(results.collisions) + len(results.broken)),
        methods=method_tables(entries),
        paper=_paper(entries) if suite == "paper" else None,
        command=str(manifest.get("command", "")),
        origins=origins_of(entries),
        commands=commands_table(entries),
        seeds=seeds,
    )


def _order_runs(runs: Sequence[RunFolder], manifest: Entry) -> tuple[RunFolder, ...]:
    place = {cell.get("name"): k for k, cell in enumerate(manifest.get("cells", ()))}
    return tuple(sorted(runs, key=lambda run: place.get(run.entry["name"], len(place))))


def _missing(results: ResultFolder, manifest: Entry) -> int:
    """Return the number of requested experiments without a result."""
    held = len(results.runs) + len(results.collisions)
    asked = len(manifest.get("cells", ())) or held
    return asked - held - len(results.broken)


def _skipped_table(results: ResultFolder) -> ReportTable:
    caption = "Folders that are damaged or of another version: in no table below."
    return ReportTable("skipped", "Not read", caption, ("folder", "reason"), results.skipped, 2)


def _sections(entries: Sequence[Entry]) -> tuple[tuple[Section, ReportTable, ReportTable], ...]:
    """Return the sections with at least one metric."""
    tables = ((section, section_by_group(section, entries)) for section in SECTIONS)
    return tuple(
        (section, groups, section_by_run(section, entries))
        for section, groups in tables
        if groups.rows and len(groups.headings) > groups.text_columns
    )


def _seeds(entries: Sequence[Entry]) -> tuple[int, int]:
    """Return the fewest and the most successful seeds of a group with any."""
    counts = [len({e["seed"] for e in runs if succeeded(e)}) for runs in by_group(entries).values()]
    kept = [count for count in counts if count] or [0]
    return min(kept), max(kept)


def seeds_text(seeds: tuple[int, int]) -> str:
    """Return fewest and most seeds as text."""
    low, high = seeds
    return str(high) if low == high else f"{low} to {high}"


def _subtitle(entries: Sequence[Entry], seeds: tuple[int, int], missing: int) -> str:
    parts = [f"{len(entries)} run{'' if len(entries) == 1 else 's'}"]
    parts.append("one seed: no confidence interval" if seeds[1] <= 1 else f"{seeds_text(seeds)} seeds")
    if missing > 0:
        parts.append(f"{missing} that were asked for are not there (yet)")
    return "; ".join(parts) + "."


def _paper(entries: Sequence[Entry]) -> Paper:
    intro = (
        "LIRS-WCT's paper compared SLAM methods on three terrains, each as a heightmap and as a solid model, "
        "by the real-time factor of a Husky. Here the same in MuJoCo, the paper's values beside it."
    )
    return Paper(intro, paper_tables(entries), findings(entries))
