"""The command `map`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from lirs_validation.cli.console import RUN_FAILED, err, out
from lirs_validation.cli.progress import progress_bar

if TYPE_CHECKING:
    from lirs_validation.record.map_record import MapRecord

Log = Annotated[
    str, typer.Argument(metavar="LOG", help="CARMEN log (.clf, .log, gzipped or not) or ROS bag.")
]
MapperName = Annotated[
    str, typer.Option(metavar="NAME|module:Class", help="SLAM method: hector, gmapping, cartographer, ...")
]
Particles = Annotated[int | None, typer.Option(help="Number of gmapping's particles; default: 30.")]
Relations = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="True relations between poses: the record then holds the accuracy."),
]
Reference = Annotated[
    str | None,
    typer.Option(
        metavar="FILE", help="Reference trajectory (TUM, ROS bag, or CARMEN of corrected poses); the same."
    ),
]
ReferenceTopic = Annotated[
    str | None,
    typer.Option(
        metavar="TOPIC",
        help="Of a reference that is a bag: its poses; default: /tf, else the only such topic.",
    ),
]
ImuFile = Annotated[
    str | None,
    typer.Option("--imu", metavar="FILE", help="Inertial readings at the scans: imu.csv.gz of a run."),
]
AttitudeName = Annotated[
    str,
    typer.Option(
        "--attitude", metavar="imu|none", help="What the mapper is told of roll and pitch: --imu, or none."
    ),
]
Fov = Annotated[
    float | None, typer.Option(metavar="DEG", help="Field of view of the laser, if the log does not say it.")
]
ScanTopic = Annotated[
    str | None, typer.Option(metavar="TOPIC", help="Of a bag: laser scans; default: the only such topic.")
]
OdomTopic = Annotated[
    str | None, typer.Option(metavar="TOPIC", help="Of a bag: odometry; default: the only one, else /tf.")
]
ImuTopic = Annotated[
    str | None, typer.Option(metavar="TOPIC", help="Of a bag: inertial readings; default: none.")
]
RangeMax = Annotated[
    float | None, typer.Option(metavar="METRES", help="Ranges from here on mean that nothing was there.")
]

Resolution = Annotated[
    float | None, typer.Option(metavar="METRES", help="Edge of a map's cell; default: the mapper's own.")
]
Output = Annotated[Path, typer.Option("-o", "--output", help="Folder for the map's folder.")]


def map_log(
    log: Log,
    mapper: MapperName = "cartographer",
    seed: Annotated[int, typer.Option(help="Seed of the mapper's random numbers.")] = 1,
    particles: Particles = None,
    resolution: Resolution = None,
    relations: Relations = None,
    reference: Reference = None,
    imu: ImuFile = None,
    attitude: AttitudeName = "imu",
    fov: Fov = None,
    range_max: RangeMax = None,
    scan_topic: ScanTopic = None,
    odom_topic: OdomTopic = None,
    imu_topic: ImuTopic = None,
    reference_topic: ReferenceTopic = None,
    output: Output = Path("out"),
) -> None:
    """Map a laser log: map.pgm and map.yaml for ROS, the path, a picture, and its accuracy."""
    from lirs_validation.config import ATTITUDES, MapConfig
    from lirs_validation.logs.map_log import run_mapping
    from lirs_wct.sources.option_text import chosen

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
        imu=imu,
        attitude=chosen(attitude, "--attitude", ATTITUDES),
        scan_topic=scan_topic,
        odom_topic=odom_topic,
        imu_topic=imu_topic,
        reference_topic=reference_topic,
    )
    with progress_bar(log, err) as progress:
        mapped = run_mapping(config, out=output, progress=progress)
    out.print(figures_table(mapped.record))
    out.print(f"{mapped.folder}", soft_wrap=True, highlight=False)
    if mapped.record.status != "ok":
        raise typer.Exit(RUN_FAILED)


def figures_table(record: MapRecord) -> Table:
    """Return the metrics of a mapped log, and what was wrong with it, as a table to print."""
    from lirs_validation.record.map_formatting import map_lines, repair_lines
    from lirs_validation.record.odometry import WORSE

    table = Table(title=record.config.log, show_header=False, title_justify="left")
    for name, value in map_lines(record):
        table.add_row(name, value, style="yellow" if value == WORSE else "")
        if name == "status" and record.reason:
            table.add_row("", record.reason, style="yellow")
    for name, value in repair_lines(record):
        table.add_row(name, value, style="yellow")
    return table
