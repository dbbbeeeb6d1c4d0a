"""The command `map`: a log becomes a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from lirs_validation.cli.console import RUN_FAILED, err, out
from lirs_validation.cli.progress import progress_bar

if TYPE_CHECKING:
    from lirs_validation.record.map_record import MapRecord

Log = Annotated[str, typer.Argument(metavar="LOG", help="CARMEN log: .clf or .log, gzipped or not.")]
MapperName = Annotated[
    str, typer.Option(metavar="hector|gmapping|cartographer", help="SLAM method that maps.")
]
Particles = Annotated[int | None, typer.Option(help="Paths that gmapping follows; default: 30.")]
Relations = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="True relations between poses: the record then tells the accuracy."),
]
Reference = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="Reference trajectory (TUM, or CARMEN of corrected poses); the same."),
]
Fov = Annotated[
    float | None, typer.Option(metavar="DEG", help="Field of view of the laser, if the log does not say it.")
]
RangeMax = Annotated[
    float | None, typer.Option(metavar="METRES", help="Ranges from here on mean that nothing was there.")
]


def map_log(
    log: Log,
    mapper: MapperName = "cartographer",
    seed: Annotated[int, typer.Option(help="Seed of the mapper's random numbers.")] = 1,
    particles: Particles = None,
    resolution: Annotated[
        float | None, typer.Option(metavar="METRES", help="Edge of a map's cell; default: the mapper's own.")
    ] = None,
    relations: Relations = None,
    reference: Reference = None,
    fov: Fov = None,
    range_max: RangeMax = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the map's folder.")] = Path(
        "out"
    ),
) -> None:
    """Map a laser log: map.pgm and map.yaml for ROS, the path, a picture, and how right it is."""
    from lirs_validation.config import MapConfig
    from lirs_validation.logs.mapping import run_mapping

    config = MapConfig(
        log=log,
        mapper=mapper,
        seed=seed,
        particles=particles,
        resolution=resolution,
        fov=fov,
        range_max=range_max,
        relations=relations,
        reference=reference,
    )
    with progress_bar(log, err) as progress:
        mapped = run_mapping(config, out=output, progress=progress)
    out.print(figures_table(mapped.record))
    out.print(f"{mapped.folder}", soft_wrap=True, highlight=False)
    if mapped.record.status != "ok":
        raise typer.Exit(RUN_FAILED)


def figures_table(record: MapRecord) -> Table:
    """Return the figures of a mapped log, and what was wrong with it, as a table to print."""
    from lirs_validation.record.map_formatting import map_lines, repair_lines

    table = Table(title=record.config.log, show_header=False, title_justify="left")
    for name, value in map_lines(record):
        table.add_row(name, value)
    for name, value in repair_lines(record):
        table.add_row(name, value, style="yellow")
    return table
