"""The report on a folder of results: tables, charts and pictures of its runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

from lirs_validation.analysis.results import ResultFolder, RunFolder
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.metric_catalog import (
    WORSE,
    Entry,
    Section,
    metrics_in,
    metrics_selected,
    rtf_counts,
    span,
    worse_than_odometry,
)
from lirs_validation.record.run_record import RunGroup, by_group, succeeded, unusual_fields
from lirs_validation.record.verdict import LIMITS, VerdictLimits, stored_verdict
from lirs_validation.report.page import PageFigure, PageSection, Tile, page_html
from lirs_validation.report.paper import suite_tables
from lirs_validation.report.pictures import distribution_chart, rtf_chart, run_figure
from lirs_validation.report.run_tables import (
    SECTIONS,
    checks_failed_table,
    collision_table,
    commands_table,
    failures_table,
    group_table,
    method_tables,
    section_by_run,
    summary_table,
    verdicts_by_method,
)
from lirs_validation.report.table import ReportTable

MAX_PICTURES = 120
"""Largest number of runs with pictures; of more runs, the first seed of each group is shown."""
TEXTS: dict[Section, str] = {
    "rtf": "Simulated seconds per wall second of the whole loop, without compilation; its parts in wall "
    "milliseconds per simulated second; and the same drive replayed through MuJoCo's step alone.",
    "trajectory": "Errors of the mapper's final trajectory in the plane, against the simulator's truth.",
    "map": "Walls agree: F1 of the built map against one of the same scans at the true poses. Walls false: "
    "share of its occupied cells that are no wall of the world. Both after the alignment of the ATE; for the "
    "other figures, the true start pose places the map.",
    "contacts": "Contacts of the robot while mapping, and their penetration.",
    "cost": "Processor time of the drive, peak memory of the process, compilation before the clock starts, "
    "and the mapper's time per scan.",
}
METHODS = (
    "The published, planar method in each world, compared with the same method with the robot's attitude and "
    "with odometry alone."
)
PAPER = (
    "Tables of LIRS-WCT's paper (ICRA 2020) beside the same runs here: real-time factor (RTF) of three SLAM "
    "methods with a Husky in three worlds; of several seeds, mean ± half width of its 95 % interval. "
    "Heightmap-based, here: MuJoCo's height field and its rays. Solid-based, here: a mesh and MuJoCo's rays. "
    "Ours: the height field and the builtin ray caster; the paper has no such column. The paper's RTFs are "
    "Gazebo's on an older computer: compare ratios of columns, not values."
)
COLLISIONS = (
    "Each robot driven at random at full speed, then up the steepest ground it may drive; every contact of "
    "every step is held against its limit."
)
PICTURES = (
    "Left: terrain with the true path (blue) and the estimated one (vermillion). Middle: the map that the "
    "true poses give. Right: the built map; vermillion cells are farther than 0.10 m from any occupied cell "
    "of the true-pose map."
)
MARKDOWN_SECTIONS = ("paper", "verdicts", "failures", "summary")
"""Keys of the sections in Markdown."""
SKIPPED = "Folders that are damaged or of another version: in no other table."


@dataclass(frozen=True, kw_only=True)
class Report:
    """The contents of a report; runs are in the order of the sweep.

    Attributes:
        sections: Sections without charts and pictures, also empty ones.
        seeds: Fewest and most successful seeds of a group; (0, 0) without any.
        checks: Collision validations that passed, and all.
    """

    title: str
    subtitle: str
    runs: tuple[RunFolder, ...]
    sections: tuple[PageSection, ...]
    seeds: tuple[int, int]
    checks: tuple[int, int]

    @property
    def entries(self) -> list[Entry]:
        """The records."""
        return [run.entry for run in self.runs]

    @property
    def tables(self) -> dict[str, ReportTable]:
        """Every table that has rows, by its key."""
        tables = [table for section in self.sections for table in (*section.tables, *section.folded)]
        return {table.key: table for table in tables if table.rows}


def report_of(results: ResultFolder, limits: VerdictLimits = LIMITS) -> Report:
    """Return the contents of a report on results, with verdicts by limits."""
    manifest = results.manifest or {}
    place = {cell.get("name"): k for k, cell in enumerate(manifest.get("cells", ()))}
    ordered = sorted(results.runs, key=lambda run: place.get(run.entry["name"], len(place)))
    runs = tuple(
        replace(run, entry={**run.entry, "verdict": stored_verdict(run.entry, limits).to_dict()})
        for run in ordered
    )
    entries = [run.entry for run in runs]
    driven = by_group(filter(succeeded, entries)).values()
    counts = [len({run["seed"] for run in runs}) for runs in driven] or [0]
    seeds = min(counts), max(counts)
    failed = [verdict for verdict in results.collisions if not verdict.passed]
    skipped = ReportTable("skipped", "Not read", SKIPPED, ("folder", "reason"), results.skipped, 2)
    paper = suite_tables(suite := manifest.get("suite"), entries)
    command = manifest.get("command")
    failures = failures_table(entries), checks_failed_table(failed, results.broken), skipped
    sections = (
        PageSection("paper", "The paper's experiment", PAPER, paper),
        PageSection("verdicts", "Verdict", tables=(verdicts_by_method(entries),)),
        PageSection("failures", "Failures", tables=failures),
        PageSection("summary", "Summary", tables=(summary_table(entries),)),
        PageSection("methods", "As published", METHODS, method_tables(entries)),
        *(
            PageSection(key, title, TEXTS[key], (groups,), (section_by_run(key, entries),))
            for key, title in SECTIONS.items()
            if (groups := group_table(key, title, metrics_in(key), entries)).has_numbers
        ),
        PageSection("collisions", "Collisions", COLLISIONS, (collision_table(results.collisions),)),
        PageSection("distributions", "Distributions"),
        PageSection("pictures", "Maps and paths", PICTURES),
        PageSection(
            "provenance",
            "Commands and versions",
            tables=(versions_table(entries),),
            folded=(commands_table(entries),),
            commands=(str(command),) if command else (),
        ),
    )
    return Report(
        title=f"The paper's experiment: {suite}" if paper else f"Validation runs in {results.root.name}",
        subtitle=_subtitle(results, entries, seeds),
        runs=runs,
        sections=sections,
        seeds=seeds,
        checks=(len(results.collisions) - len(failed), len(results.collisions) + len(results.broken)),
    )


def report_markdown(report: Report) -> str:
    """Return verdicts, failures and summary as Markdown, without links to files."""
    sections = (section for section in report.sections if section.key in MARKDOWN_SECTIONS)
    tables = (table.as_markdown() for section in sections for table in section.tables if table.rows)
    return "\n".join((f"# {report.title}\n\n{report.subtitle}\n", *tables))


def report_page(report: Report, command: str) -> str:
    """Return the report as HTML; `command` made it."""
    drawn = report.entries
    count = sum(map(succeeded, drawn))
    figures = {
        "rtf": rtf_chart(drawn),
        "distributions": distribution_chart(drawn, metrics_selected("distribution")),
    }
    made_from = f"Made from {count} run{'' if count == 1 else 's'} that finished."
    pictures, note = _pictures(report.runs)
    sections = []
    for section in report.sections:
        if (figure := figures.get(section.key)) is not None:
            section = replace(section, figures=(replace(figure, caption=f"{figure.caption} {made_from}"),))
        elif section.key == "pictures":
            section = replace(section, text=f"{section.text} {note}", figures=pictures)
        elif section.key == "provenance":
            section = replace(section, commands=(*section.commands, command))
        tables = tuple(table for table in section.tables if table.rows)
        if tables or section.figures:
            sections.append(replace(section, tables=tables))
    return page_html(report.title, [report.subtitle], sections, _tiles(report))


def _pictures(runs: Sequence[RunFolder]) -> tuple[tuple[PageFigure, ...], str]:
    """Return the pictures of runs with maps, and a note on omitted ones."""
    drawn = [run for run in runs if run.entry["map"]]
    shown, note = drawn, ""
    if len(drawn) > MAX_PICTURES:
        first: dict[RunGroup, RunFolder] = {}
        for run in sorted(drawn, key=lambda r: int(r.entry["seed"])):
            first.setdefault(RunGroup.of(run.entry), run)
        shown = [run for run in drawn if run in first.values()][:MAX_PICTURES]
        note = f"Shown are {len(shown)} of {len(drawn)} runs: the first seed of each group."
    scenarios = ScenarioCache()
    figures = []
    for run in shown:
        group, status = RunGroup.of(run.entry), run.entry["status"]
        fields = {"world", "robot", "mapper", "terrain", "rays", *unusual_fields([group])}
        name = f"{group.label(fields)}, seed {run.entry['seed']}"
        name += "" if status == "ok" else f": {status}"
        name += f": {WORSE}" if worse_than_odometry(run.entry) else ""
        figures.append(replace(run_figure(run, scenarios), caption=name))
    return tuple(figures), note


def _tiles(report: Report) -> list[Tile]:
    entries = report.entries
    good = [entry for entry in entries if succeeded(entry)]
    seeds = "seed" if report.seeds[1] == 1 else "seeds"
    tiles = [
        Tile(f"{len(good)} of {len(entries)}", "runs finished", bad=len(good) < len(entries)),
        Tile(_seeds_text(report.seeds), seeds),
    ]
    if len(by_group(entries)) == 1:  # methods and worlds are not mixed
        rtf = [float(e["rtf"]["mean"]) for e in good if rtf_counts(e) and not e["rtf"]["extrapolated"]]
        tiles += [Tile(span(rtf), "RTF")] if rtf else []
        for metric in metrics_selected("headline"):
            if values := [v for e in good if (v := metric.of(e)) is not None]:
                some = "" if len(values) == len(good) else f" ({len(values)} of {len(good)} runs)"
                tiles.append(Tile(metric.formatted(median(values)), f"median {metric.heading}{some}"))
    passed, count = report.checks
    if count:
        tiles.append(Tile(f"{passed} of {count}", "collision checks passed", bad=passed < count))
    return tiles


def versions_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the software and machines of the runs."""
    origins = Counter(
        (
            ", ".join(f"{name} {version}" for name, version in entry["versions"].items()),
            "{processor}, {cores} cores, {system}".format(**entry["machine"]),
        )
        for entry in entries
    )
    rows = tuple((str(count), *origin) for origin, count in origins.items())
    return ReportTable("versions", "Versions and machines", "", ("runs", "versions", "machine"), rows, 3)


def _seeds_text(seeds: tuple[int, int]) -> str:
    low, high = seeds
    return str(high) if low == high else f"{low} to {high}"


def _subtitle(results: ResultFolder, entries: Sequence[Entry], seeds: tuple[int, int]) -> str:
    finished = len(results.runs) + len(results.collisions)
    requested = len((results.manifest or {}).get("cells", ())) or finished
    missing = requested - finished - len(results.broken)
    parts = [f"{len(entries)} run{'' if len(entries) == 1 else 's'}"]
    parts.append("one seed: no confidence interval" if seeds[1] <= 1 else f"{_seeds_text(seeds)} seeds")
    if missing > 0:
        parts.append(f"{missing} that were asked for are not there (yet)")
    return "; ".join(parts) + "."
