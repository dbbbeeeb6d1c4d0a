"""The report as one self-contained HTML page: no network, no scripts, no other files."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from statistics import median
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from lirs_validation.analysis.groups import RunGroup, by_group, unusual_fields
from lirs_validation.analysis.results import ResultFolder, RunFolder
from lirs_validation.record.metric_catalog import (
    WORSE,
    WORSE_MARK,
    Entry,
    Section,
    metrics_selected,
    rtf_counts,
    span,
    worse_than_odometry,
)
from lirs_validation.record.run_record import succeeded
from lirs_validation.report.charts import AROUND, distribution_chart, rtf_chart
from lirs_validation.report.collision_tables import checks_failed_table, collision_table
from lirs_validation.report.paper import Finding, findings, paper_tables
from lirs_validation.report.pictures import Painter, RunPicture
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
from lirs_wct.drawing.canvas import Drawing

SKIPPED = "Folders that are damaged or of another version: in no table below."
MOST_PICTURES = 120
"""Largest number of runs with pictures; of more runs, the first seed of each group is shown."""
INTROS: dict[Section, str] = {
    "rtf": "Simulated seconds per wall second of the whole loop, without compilation; its parts in wall "
    "milliseconds per simulated second; and the same drive replayed through MuJoCo's step alone.",
    "trajectory": "Errors of the mapper's final trajectory in the plane, against the simulator's truth.",
    "map": "F1 compares the built map with one built from the same scans at the true poses, both placed by "
    "the true start pose, and once more after the alignment of the ATE. False occupied compares both maps "
    "with the world's geometry, because F1 does not show errors that both maps share.",
    "contacts": "Contacts of the robot while mapping, and their penetration.",
    "cost": "Processor time of the drive, peak memory of the process, compilation before the clock starts, "
    "and the mapper's time per scan.",
}


def page(report: Report, command: str) -> str:
    """Return the report as HTML."""
    pictures, note = _pictures(report.runs)
    spread = _spread(report)
    return render(
        "report.html.j2",
        title=report.title,
        report=report,
        report_command=command,
        contents=_contents(report, drawn=bool(pictures), spread=bool(spread)),
        tiles=_tiles(report),
        intros=INTROS,
        rtf=_rtf_over_time(report),
        spread=spread,
        pictures=pictures,
        pictures_note=note,
        succeeded=sum(map(succeeded, report.entries)),
    )


def render(template: str, package: str = __package__, **context: Any) -> str:
    """Return a package's template as HTML, with the report's style."""
    own = PackageLoader(__package__)
    environment = Environment(
        loader=ChoiceLoader([own, PackageLoader(package)]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    style, _, _ = own.get_source(environment, "report.css")
    return environment.get_template(template).render(style=style, worse_mark=WORSE_MARK, **context)


def png(drawing: Drawing) -> bytes:
    """Return a drawing as a PNG file."""
    picture = BytesIO()
    drawing.savefig(picture, dpi=110, format="png")
    return picture.getvalue()


def data_url(picture: bytes) -> str:
    """Return the address of a PNG file that a page holds itself."""
    return "data:image/png;base64," + base64.b64encode(picture).decode()


def _rtf_over_time(report: Report) -> dict[str, str] | None:
    drawn = rtf_chart(report.entries)
    if drawn is None:
        return None
    caption = (
        "RTF over simulated time, as in the paper's Fig. 13: mean and a band of one standard deviation, over "
        f"seeds; where a method has one seed, over {2 * AROUND + 1} s of its run."
    )
    if drawn[1]:
        caption += f" {drawn[1]} more panels are left out; their values stand in the table."
    return {"svg": drawn[0], "caption": caption}


def _spread(report: Report) -> dict[str, str] | None:
    drawn = distribution_chart(report.entries, metrics_selected("distribution"))
    if drawn is None:
        return None
    caption = (
        "Every run that finished is a dot, the bar their median, the dotted bar their odometry's median; "
        "one row a group."
    )
    if drawn[1]:
        caption += f" {drawn[1]} more groups are left out; their values stand in the tables."
    return {"svg": drawn[0], "caption": caption}


def _pictures(runs: Sequence[RunFolder]) -> tuple[list[RunPicture], str]:
    """Return the pictures of runs with maps, and a note on omitted ones."""
    drawn = [run for run in runs if run.entry["map"]]
    chosen, note = drawn, ""
    if len(drawn) > MOST_PICTURES:
        chosen = first_seeds(drawn)[:MOST_PICTURES]
        note = f"Shown are {len(chosen)} of {len(drawn)} runs: the first seed of each group."
    painter = Painter(len(chosen))
    pictures = []
    for run in chosen:
        group = RunGroup.of(run.entry)
        shown = {"world", "robot", "mapper", "terrain", "rays", *unusual_fields([group])}
        name = f"{group.label(shown)}, seed {run.entry['seed']}"
        name += "" if run.entry["status"] == "ok" else f": {run.entry['status']}"
        name += f": {WORSE}" if worse_than_odometry(run.entry) else ""
        pictures.append(replace(painter.paint(run), name=name))
    return pictures, note


def first_seeds(runs: Sequence[RunFolder]) -> list[RunFolder]:
    """Return the run with the smallest seed of each group, in the given order."""
    first: dict[RunGroup, RunFolder] = {}
    for run in sorted(runs, key=lambda r: int(r.entry["seed"])):
        first.setdefault(RunGroup.of(run.entry), run)
    return [run for run in runs if first[RunGroup.of(run.entry)] is run]


def _tiles(report: Report) -> list[dict[str, Any]]:
    entries = report.entries
    good = [entry for entry in entries if succeeded(entry)]
    failed = len(entries) - len(good)
    seeds = "seed" if report.seeds[1] == 1 else "seeds"
    tiles: list[dict[str, Any]] = [
        {"value": f"{len(good)} of {len(entries)}", "name": "runs finished", "bad": failed > 0},
        {"value": seeds_text(report.seeds), "name": seeds, "bad": False},
    ]
    if len(by_group(entries)) == 1:
        tiles += _metric_tiles(good)
    if report.collisions.rows:
        passed, of = report.checks
        tiles.append({"value": f"{passed} of {of}", "name": "collision checks passed", "bad": passed < of})
    return tiles


def _metric_tiles(good: Sequence[Entry]) -> list[dict[str, Any]]:
    """Return tiles of the successful runs of one group: methods and worlds are not mixed."""
    tiles: list[dict[str, Any]] = []
    alone = [float(e["rtf"]["mean"]) for e in good if rtf_counts(e) and not e["rtf"]["extrapolated"]]
    if alone:
        tiles.append({"value": span(alone), "name": "RTF", "bad": False})
    for metric in metrics_selected("headline"):
        values = [v for e in good if (v := metric.of(e)) is not None]
        if values:
            held = "" if len(values) == len(good) else f" ({len(values)} of {len(good)} runs)"
            name = f"median {metric.heading}{held}"
            tiles.append({"value": metric.formatted(median(values)), "name": name, "bad": False})
    return tiles


def _contents(report: Report, *, drawn: bool, spread: bool) -> list[tuple[str, str]]:
    """Return anchors and names of the page's sections."""
    sections = [
        ("failed", "Failures", report.failures.rows or report.checks_failed.rows or report.skipped.rows),
        ("overview", "Summary", report.summary.rows),
        ("methods", "As published", report.methods),
        ("paper", "The paper", report.paper),
        *((f"{key}-section", groups.title, True) for key, groups, _ in report.sections),
        ("collisions", "Collisions", report.collisions.rows),
        ("distributions", "Distributions", spread),
        ("pictures", "Maps and paths", drawn),
        ("provenance", "Commands and versions", True),
    ]
    return [(key, name) for key, name, there in sections if there]


@dataclass(frozen=True, kw_only=True)
class Report:
    """The contents of a report on a folder of results.

    Attributes:
        runs: runs in the order of the sweep.
        sections: key, table by group and table by run of each section of metrics.
        checks: collision validations that passed, and all.
        methods: comparison of methods as published, or without attitude, with terrain-aware ones.
        paper: the paper's tables beside ours; empty except for the paper's suite.
        findings: the paper's findings, with the same exception.
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
    paper: tuple[ReportTable, ...]
    findings: tuple[Finding, ...]
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
        tables = [self.verdicts, self.failures, self.checks_failed, self.skipped, self.summary]
        tables += [*self.methods, *self.paper]
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
        skipped=ReportTable("skipped", "Not read", SKIPPED, ("folder", "reason"), results.skipped, 2),
        summary=summary_table(entries),
        sections=_sections(entries),
        collisions=collision_table(results.collisions),
        checks=(len(results.collisions) - len(failed), len(results.collisions) + len(results.broken)),
        methods=method_tables(entries),
        paper=paper_tables(entries) if suite == "paper" else (),
        findings=findings(entries) if suite == "paper" else (),
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
