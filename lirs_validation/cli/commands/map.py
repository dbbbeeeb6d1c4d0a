"""The command `map`."""

from __future__ import annotations

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
