"""Commands about results: `report`, `compare`, `score`, `export`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from click.exceptions import Exit

from lirs_validation.cli.command import BagOptions, LimitsOption
from lirs_validation.cli.exit_codes import ExitCode
from lirs_validation.cli.progress import err, note, out, say
from lirs_wct.errors import ConfigError
from lirs_wct.option import Options, argument, command_line, option, read_pairs


def read_offset(text: str, label: str) -> float | Literal["auto"]:
    """Return a time offset, seconds."""
    if text == "auto":
        return "auto"
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        raise ConfigError(f"{label} must be a number of seconds or auto, got {text!r}")
    return seconds


@dataclass(frozen=True, kw_only=True)
class ReportOptions(LimitsOption):
    """Results and files of `report`."""

    results: Path = argument("Folder of a sweep, or of one run.", "RESULTS")
    output: Path = option(Path("report.html"), "HTML file to write.", metavar="FILE.html")
    markdown: Path | None = option(None, "Verdicts and summary as Markdown.", metavar="FILE.md")
    tables: Path | None = option(None, "Folder for all tables as CSV.", metavar="FOLDER")


@dataclass(frozen=True, kw_only=True)
class CompareOptions(Options):
    """Results and table of `compare`."""

    a: str = argument("Folder of results; `A:mapper=hector` takes only these of its runs.", "A")
    b: str = argument("Folder of results to compare with A, or some of its runs.", "B")
    across: tuple[str, ...] = option(
        (),
        "Pair runs that differ in these: world, robot, mapper, terrain, rays, lidar, seconds, attitude, "
        "driver, actors.",
        metavar="FIELD,...",
    )
    figures: tuple[str, ...] = option(
        (), "Metrics of the record to compare, such as map.f1,rtf.mean.", metavar="KEY,..."
    )
    output: Path | None = option(None, "File for the table.", metavar="FILE.csv|FILE.json")


@dataclass(frozen=True, kw_only=True)
class ScoreOptions(Options):
    """Run and results of `score`."""

    run: Path = argument("Folder of a run.", "RUN")
    trajectory: Path | None = option(
        None,
        "Poses of base_link, at stamps of the run's scans: a TUM file, or a bag; BAG:/TOPIC names odometry, "
        "stamped poses, a path or /tf; default: map -> base_link on /tf, else the only topic of poses.",
        metavar="FILE|BAG[:/TOPIC]",
    )
    map: Path | None = option(None, "ROS map: a YAML with its picture.", metavar="FILE.yaml")
    frame: Literal["auto", "map", "world", "align"] = option(
        "auto",
        "Frame of both: map, whose origin is the first base pose; world, as the run's own files; "
        "auto: by where the trajectory begins; of a map alone, by where it fits; align: any, moved to "
        "the best fit.",
    )
    time_offset: float | Literal["auto"] = option(
        0.0,
        "Added to the trajectory's stamps; auto: found by its motion.",
        metavar="SECONDS|auto",
        reader=read_offset,
    )
    output: Path = option(Path("score.json"), "JSON to write.", metavar="FILE.json")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.trajectory is None and self.map is None:
            raise ConfigError("nothing to score: give --trajectory, --map or both")


@dataclass(frozen=True, kw_only=True)
class ExportCommand(BagOptions):
    """Run or robot, and formats of `export`."""

    source: str = argument("Folder of a run, or the name of a robot.", "RUN|ROBOT")
    to: tuple[str, ...] = option(
        ("bag",), "Formats of a run: bag, csv, npz, carmen, evalio; of a robot: urdf.", metavar="F,F,..."
    )
    output: Path | None = option(None, "Folder to write to; default: export/ in RUN; of a robot, here.")


def report(options: ReportOptions) -> None:
    """Report on a folder of results: one HTML page that opens anywhere, offline.

    Examples:
    lirs-wct report out/ -o report.html --markdown report.md
    """
    from lirs_validation.analysis.results import read_results
    from lirs_validation.record.verdict import read_limits
    from lirs_validation.report.run_report import report_markdown, report_of, report_page

    results, output, (limits, _) = options.results, options.output, read_limits(options.limits)
    with err.status(f"reading {results}") as status:
        read = read_results(results)
        _print_skipped(read.skipped)
        contents = report_of(read, limits)
        status.update("drawing")
        html = report_page(contents, command_line("report", str(results), options))
    _write(output, html)
    if options.markdown is not None:
        _write(options.markdown, report_markdown(contents))
    if options.tables is not None:
        for table in contents.tables.values():
            _write(options.tables / f"{table.key}.csv", table.as_csv())
    say(f"{output}: {len(contents.runs)} runs, {len(html.encode()) / 1e6:.1f} MB")


def compare(options: CompareOptions) -> None:
    """Compare two results: which differences are statistically significant (Holm).

    Examples:
    lirs-wct compare out/a out/b
    lirs-wct compare out/:mapper=hector out/:mapper=gmapping --across mapper
    """
    from lirs_validation.analysis.compare import compare as compared, only
    from lirs_validation.analysis.results import read_results
    from lirs_validation.record.metric_catalog import metrics_named, metrics_selected
    from lirs_validation.report.compare_tables import compare_table, write_comparison

    if options.output is not None and options.output.suffix not in (".csv", ".json"):
        raise ConfigError(f"{options.output}: must end in .csv or .json")
    (first, only_a), (second, only_b) = (_selected(text) for text in (options.a, options.b))
    results = read_results(first), read_results(second)
    _print_skipped(results[0].skipped + results[1].skipped)
    comparison = compared(
        only([run.entry for run in results[0].runs], only_a),
        only([run.entry for run in results[1].runs], only_b),
        metrics_named(options.figures) if options.figures else metrics_selected("compared"),
        options.across,
    )
    names = options.a, options.b
    out.print(compare_table(comparison, names))
    if options.output is not None:
        write_comparison(options.output, comparison, names)


def _selected(text: str) -> tuple[Path, dict[str, str]]:
    """Return folder and fields of results such as `out/:mapper=hector,world=medium`."""
    folder, _, fields = text.rpartition(":")
    if not folder or "=" not in fields:
        return Path(text), {}
    return Path(folder), read_pairs(fields, text)


def score(options: ScoreOptions) -> None:
    """Score another program's results from a run's recorded scans (scans.clf.gz or bag).

    Examples:
    lirs-wct score out/RUN --trajectory est.tum --map map.yaml -o score.json
    """
    from lirs_validation.analysis.results import read_run
    from lirs_validation.analysis.score import score as scored
    from lirs_validation.report.compare_tables import score_table, write_score

    recorded = read_run(options.run)
    result = scored(
        recorded,
        trajectory=options.trajectory,
        map_yaml=options.map,
        frame=options.frame,
        time_offset=options.time_offset,
    )
    out.print(score_table(result, recorded.entry))
    verdict = result.verdict(recorded.entry)
    write_score(options.output, result, verdict, options.trajectory, options.map)
    say(options.output)
    if verdict is not None:
        say(f"verdict: {verdict}")
    if result.status != "ok":
        raise Exit(ExitCode.RUN_FAILED)


def export(options: ExportCommand) -> None:
    """Export a finished run as ROS 2 bag, CSV, NumPy archive, CARMEN log or data set of evalio.

    Of a robot, a description for RViz.

    Examples:
    lirs-wct export out/RUN --to bag,csv -o exported/
    lirs-wct export husky --to urdf
    """
    from lirs_envs.robots.robot import ROBOTS
    from lirs_envs.robots.urdf import robot_urdf
    from lirs_validation.analysis.export import export_run
    from lirs_validation.analysis.results import read_run

    name, formats = options.source, options.to
    if name not in ROBOTS:
        with err.status(f"exporting {name}"):
            folder, slam = options.output or Path(name) / "export", not options.sensors_only
            paths = export_run(read_run(Path(name)), folder, formats, storage=options.storage, slam=slam)
    elif formats != ("urdf",):
        raise ConfigError(f"{name}: a robot is exported --to urdf, got {','.join(formats)}")
    else:
        paths = [(options.output or Path()) / f"{name}.urdf"]
        _write(paths[0], robot_urdf(ROBOTS[name]))
    for path in paths:
        say(path)


def _write(path: Path, text: str) -> None:
    from lirs_wct.files import atomic_write

    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _print_skipped(skipped: tuple[tuple[str, str], ...]) -> None:
    for name, reason in skipped:
        note(f"skipped {name}: {reason}", style="yellow")
