"""The command `map`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from click.exceptions import Exit
from rich.table import Table

from lirs_validation.cli.command import common
from lirs_validation.cli.progress import RUN_FAILED, err, out, progress_bar
from lirs_validation.map_config import MapConfig
from lirs_wct.option import Options, argument, option

if TYPE_CHECKING:
    from lirs_validation.record.map_record import MapRecord


@dataclass(frozen=True, kw_only=True)
class LogInOut(Options):
    """Log and results of a command."""

    log: str = argument("CARMEN log (.clf, .log, gzipped or not) or ROS bag.", "LOG")
    output: Path = option(Path("out"), "Folder for the result's folder.")


@common(
    *("mapper", "output", "relations", "reference", "second", "resolution", "range_max", "fov"),
    *("seed", "imu", "scan_topic", "odom_topic", "time"),
)
def map_log(options: LogInOut, given: Annotated[dict[str, Any], MapConfig]) -> None:
    """Map a laser log: map.pgm and map.yaml for ROS, path, picture and accuracy.

    Examples:
    lirs-wct map examples/data/office.clf.gz --mapper gmapping -o out/
    """
    from lirs_validation.logs.map_log import run_mapping

    config = MapConfig(log=options.log, **given)
    with progress_bar(options.log, err) as progress:
        mapped = run_mapping(config, out=options.output, progress=progress)
    out.print(figures_table(mapped.record))
    out.print(f"{mapped.folder}", soft_wrap=True, highlight=False)
    out.print(f"verdict: {mapped.record.verdict}", soft_wrap=True, highlight=False, markup=False)
    if mapped.record.status != "ok":
        raise Exit(RUN_FAILED)


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
