"""The commands `map` and `twin`."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from lirs_validation.cli.progress import RUN_FAILED, err, out, progress_bar
from lirs_validation.map_config import MapConfig

if TYPE_CHECKING:
    from lirs_validation.record.map_record import MapRecord

Log = Annotated[
    str, typer.Argument(metavar="LOG", help="CARMEN log (.clf, .log, gzipped or not) or ROS bag.")
]
Output = Annotated[Path, typer.Option("-o", "--output", help="Folder for the map's folder.")]


def map_log(log: Log, output: Output = Path("out"), *, given: Annotated[dict[str, Any], MapConfig]) -> None:
    """Map a laser log: map.pgm and map.yaml for ROS, path, picture and accuracy."""
    from lirs_validation.logs.map_log import run_mapping

    config = MapConfig(log=log, **given)
    with progress_bar(log, err) as progress:
        mapped = run_mapping(config, out=output, progress=progress)
    out.print(figures_table(mapped.record))
    out.print(f"{mapped.folder}", soft_wrap=True, highlight=False)
    out.print(f"verdict: {mapped.record.verdict}", soft_wrap=True, highlight=False, markup=False)
    if mapped.record.status != "ok":
        raise typer.Exit(RUN_FAILED)


def figures_table(record: MapRecord) -> Table:
    """Return the metrics and repairs of a mapped log as a table to print."""
    from lirs_validation.record.map_record import map_lines, repair_lines
    from lirs_validation.record.metric_catalog import WORSE

    table = Table(title=record.config.log, show_header=False, title_justify="left")
    for name, value in map_lines(record):
        table.add_row(name, value, style="yellow" if value == WORSE else "")
        if name == "status" and record.reason:
            table.add_row("", record.reason, style="yellow")
    for name, value in repair_lines(record):
        table.add_row(name, value, style="yellow")
    return table


Lidar = Annotated[str, typer.Option(help="Preset whose data sheet the log is compared with.")]
Replayed = Annotated[
    str, typer.Option("--replay", metavar="NAMES|all|none", help="Mappers of the log and its simulation.")
]
Draws = Annotated[
    int, typer.Option(min=1, help="Simulated logs with different random numbers; errors are their medians.")
]
TwinOutput = Annotated[Path, typer.Option("-o", "--output", help="Folder for the result's folder.")]


def twin(
    log: Log,
    output: TwinOutput = Path("out"),
    lidar: Lidar = "lms200",
    replay: Replayed = "all",
    draws: Draws = 1,
    *,
    given: Annotated[dict[str, Any], MapConfig],
) -> None:
    """Compare a log with its simulation: twin.html, and fitted noise.yaml for --noise."""
    from lirs_validation.twin.replay import parse_mappers
    from lirs_validation.twin.twin import run_twin

    config = MapConfig(log=log, **given)
    with progress_bar(log, err) as progress:
        result, folder = run_twin(
            config,
            lidar=lidar,
            seed=config.seed,
            out=output,
            replayed=parse_mappers(replay),
            draws=draws,
            command=shlex.join(["lirs-wct", *sys.argv[1:]]),
            progress=progress,
        )
    for sentence in result.sentences:
        out.print(sentence, soft_wrap=True, highlight=False)
    out.print(f"{folder / 'twin.html'}", soft_wrap=True, highlight=False)
