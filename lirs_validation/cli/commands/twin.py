"""The command `twin`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lirs_validation.cli.commands.map import Log
from lirs_validation.cli.console import err, out
from lirs_validation.cli.progress import progress_bar
from lirs_validation.cli.typer_options import typer_option
from lirs_validation.config import MapConfig

Lidar = Annotated[str, typer.Option(help="Preset whose data sheet the log is compared with.")]
Output = Annotated[Path, typer.Option("-o", "--output", help="Folder for the result's folder.")]


def twin(
    log: Log,
    output: Output = Path("out"),
    lidar: Lidar = "lms200",
    mapper: Annotated[str, typer_option(MapConfig, "mapper")] = "cartographer",
    seed: Annotated[int, typer_option(MapConfig, "seed")] = 1,
    fov: Annotated[float | None, typer_option(MapConfig, "fov")] = None,
    range_max: Annotated[float | None, typer_option(MapConfig, "range_max")] = None,
    scan_topic: Annotated[str | None, typer_option(MapConfig, "scan_topic")] = None,
    odom_topic: Annotated[str | None, typer_option(MapConfig, "odom_topic")] = None,
) -> None:
    """Compare a log's lidar with the simulated one, and fit its noise: noise.yaml for --noise."""
    from lirs_validation.twin.twin import run_twin

    config = MapConfig(
        log=log,
        mapper=mapper,
        seed=seed,
        fov=fov,
        range_max=range_max,
        scan_topic=scan_topic,
        odom_topic=odom_topic,
    )
    with progress_bar(log, err) as progress:
        result, folder = run_twin(config, lidar=lidar, seed=seed, out=output, progress=progress)
    out.print(result.sentence, soft_wrap=True, highlight=False)
    out.print(f"{folder}", soft_wrap=True, highlight=False)
