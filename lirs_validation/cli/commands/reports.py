"""Commands about results: `report`, `compare`, `score`, `export`."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from lirs_validation.cli.progress import RUN_FAILED, err, out
from lirs_validation.cli.typer_options import read_fields
from lirs_wct.errors import ConfigError
from lirs_wct.option import read_names

CsvFile = Annotated[Path | None, typer.Option("--csv", help="Write the table there as CSV, too.")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Write the table there as JSON, too.")]

Across = Annotated[
    str | None,
    typer.Option(
        metavar="FIELD,...",
        help="Pair runs that differ in these: world, robot, mapper, terrain, rays, lidar, "
        "seconds, attitude, driver, actors.",
    ),
]
OnlyA = Annotated[
    str | None, typer.Option(metavar="FIELD=VALUE,...", help="Only these runs of A, such as mapper=hector.")
]
OnlyB = Annotated[str | None, typer.Option(metavar="FIELD=VALUE,...", help="Only these runs of B.")]
Figures = Annotated[
    str | None,
    typer.Option(metavar="KEY,...", help="Metrics of the record to compare, such as map.f1,rtf.mean."),
]


def report(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Folder of a sweep, or of one run.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="HTML file to write.")] = Path("report.html"),
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FOLDER", help="Write the tables there as CSV, too.")
    ] = None,
    markdown: Annotated[
        Path | None,
        typer.Option("--markdown", metavar="FILE", help="Write the tables there as Markdown, too."),
    ] = None,
) -> None:
    """Report on a folder of results: one HTML page that opens anywhere, offline."""
    from lirs_validation.analysis.result_folders import read_results
    from lirs_validation.report.page import page, report_of

    with err.status(f"reading {results}") as status:
        read = read_results(results)
        _print_skipped(read.skipped)
        contents = report_of(read)
        status.update("drawing")
        html = page(contents, shlex.join(["lirs-wct", "report", str(results), "-o", str(output)]))
    _write(output, html)
    if csv is not None:
        for table in contents.tables:
            _write(csv / f"{table.key}.csv", table.as_csv())
    if markdown is not None:
        tables = [table.as_markdown() for table in contents.tables]
        _write(markdown, "\n".join((f"# {contents.title}\n", *tables)))
    out.print(
        f"{output}: {len(contents.runs)} runs, {len(html.encode()) / 1e6:.1f} MB",
        soft_wrap=True,
        highlight=False,
    )


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Folder of results.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Folder of results to compare with A.")],
    across: Across = None,
    only_a: OnlyA = None,
    only_b: OnlyB = None,
    figures: Figures = None,
    csv: CsvFile = None,
    json: JsonFile = None,
) -> None:
    """Compare two results: which differences are statistically significant (Holm)."""
    from lirs_validation.analysis.compare import compare as compared
    from lirs_validation.analysis.compare import only
    from lirs_validation.analysis.result_folders import read_results
    from lirs_validation.record.metric_catalog import metrics_named, metrics_selected
    from lirs_validation.report.compare_tables import compare_table, write_compare_csv, write_compare_json

    names = (_result_name(a, only_a), _result_name(b, only_b))
    first, second = read_results(a), read_results(b)
    _print_skipped(first.skipped + second.skipped)
    comparison = compared(
        only([run.entry for run in first.runs], read_fields(only_a, "--only-a")),
        only([run.entry for run in second.runs], read_fields(only_b, "--only-b")),
        metrics_named(read_names(figures, "--figures")) if figures else metrics_selected("compared"),
        read_names(across, "--across") if across else (),
    )
    out.print(compare_table(comparison, names))
    if csv is not None:
        write_compare_csv(csv, comparison)
    if json is not None:
        write_compare_json(json, comparison, names)


def score(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    trajectory: Annotated[
        Path | None,
        typer.Option(help="TUM file or ROS bag: poses of base_link, at stamps of the run's scans."),
    ] = None,
    topic: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="Of a bag: odometry, stamped poses, a path or /tf; default: map -> base_link on /tf, else "
            "the only topic of poses.",
        ),
    ] = None,
    map_yaml: Annotated[Path | None, typer.Option("--map", help="ROS map: a YAML with its picture.")] = None,
    frame: Annotated[
        str,
        typer.Option(
            metavar="auto|map|world|align",
            help="Frame of both: map, whose origin is the first base pose; world, as the run's own files; "
            "auto: by where the trajectory begins; of a map alone, by where it fits; align: any, moved to "
            "the best fit.",
        ),
    ] = "auto",
    time_offset: Annotated[
        str,
        typer.Option(
            metavar="SECONDS|auto", help="Added to the trajectory's stamps; auto: found by its motion."
        ),
    ] = "0",
    output: Annotated[Path, typer.Option("-o", "--output", help="JSON to write.")] = Path("score.json"),
) -> None:
    """Score another program's results from a run's recorded scans (scans.clf.gz or bag)."""
    from lirs_validation.analysis.result_folders import read_run
    from lirs_validation.analysis.score import check_frame
    from lirs_validation.analysis.score import score as scored
    from lirs_validation.report.compare_tables import score_table, write_score

    if trajectory is None and map_yaml is None:
        raise ConfigError("nothing to score: give --trajectory, --map or both")
    if topic is not None and trajectory is None:
        raise ConfigError("--topic is of a bag that --trajectory names, which is not given")
    recorded = read_run(run)
    named = check_frame(frame)
    offset = _read_offset(time_offset)
    result = scored(
        recorded, trajectory=trajectory, topic=topic, map_yaml=map_yaml, frame=named, time_offset=offset
    )
    out.print(score_table(result, recorded.entry))
    verdict = result.verdict(recorded.entry)
    write_score(output, result, verdict, trajectory, map_yaml)
    out.print(f"{output}", soft_wrap=True, highlight=False)
    if verdict is not None:
        out.print(f"verdict: {verdict}", soft_wrap=True, highlight=False, markup=False)
    if result.status != "ok":
        raise typer.Exit(RUN_FAILED)


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    to: Annotated[
        str, typer.Option(metavar="F,F,...", help="Formats: bag, csv, npz, carmen, evalio.")
    ] = "bag",
    storage: Annotated[
        str, typer.Option(metavar="mcap|sqlite3", help="How the bag stores its messages.")
    ] = "mcap",
    sensors_only: Annotated[
        bool,
        typer.Option(
            "--sensors-only", help="A bag without map -> odom and /map: the SLAM that it feeds gives them."
        ),
    ] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder to write to; default: export/ in RUN.")
    ] = None,
) -> None:
    """Export a finished run as ROS 2 bag, CSV, NumPy archive, CARMEN log, or data set of evalio."""
    from lirs_validation.analysis.recorded_run import export_run
    from lirs_validation.analysis.result_folders import read_run
    from lirs_wct.option import chosen

    stored = chosen(storage, "--storage", ("mcap", "sqlite3"))
    formats = read_names(to, "--to")
    with err.status(f"exporting {run}"):
        folder = output or run / "export"
        written = export_run(read_run(run), folder, formats, storage=stored, slam=not sensors_only)
    for path in written:
        out.print(f"{path}", soft_wrap=True, highlight=False)


def _read_offset(text: str) -> float | Literal["auto"]:
    """Return a time offset, seconds.

    Raises:
        ConfigError: the text is no finite number and not `auto`.
    """
    if text == "auto":
        return "auto"
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        raise ConfigError(f"--time-offset must be a number of seconds or auto, got {text!r}")
    return seconds


def _result_name(folder: Path, only: str | None) -> str:
    return str(folder) if only is None else f"{folder} ({only})"


def _write(path: Path, text: str) -> None:
    from lirs_wct.files import atomic_write

    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _print_skipped(skipped: tuple[tuple[str, str], ...]) -> None:

    for name, reason in skipped:
        err.print(f"skipped {name}: {reason}", markup=False, highlight=False, soft_wrap=True, style="yellow")
