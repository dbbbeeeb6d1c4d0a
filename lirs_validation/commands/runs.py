"""Commands about runs: `validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lirs_validation.build_options import mujoco_terrain, with_build_options
from lirs_validation.commands.console import RUN_FAILED, err, out
from lirs_validation.commands.words import Sources
from lirs_wct.options import BuildOptions

if TYPE_CHECKING:
    from lirs_validation.run import Run


@with_build_options
def validate(
    sources: Sources,
    robot: Annotated[str, typer.Option(help="Robot that drives.")] = "husky",
    mapper: Annotated[str, typer.Option(help="SLAM method that maps.")] = "hector",
    lidar: Annotated[str | None, typer.Option(help="LRF preset; default: the robot's own.")] = None,
    terrain: Annotated[
        str,
        typer.Option(
            metavar="hfield|mesh|prisms|convex",
            help="What MuJoCo touches: a height field; the same, and the mesh is seen; a prism for each "
            "triangle within --max-error; the convex parts of a closed mesh.",
        ),
    ] = "hfield",
    seconds: Annotated[float, typer.Option(help="Simulated seconds to drive.")] = 120.0,
    seed: Annotated[int, typer.Option(help="Seed of every random number.")] = 1,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the runs' folders.")] = Path(
        "out"
    ),
    *,
    options: BuildOptions,
) -> None:
    """Drive a robot through worlds with SLAM running, and judge map, path and speed."""
    from lirs_validation.progress import run_with_progress
    from lirs_validation.record import RunConfig
    from lirs_validation.report.table import results_table

    configs = [
        RunConfig(
            source=source,
            robot=robot,
            mapper=mapper,
            lidar=lidar,
            terrain=mujoco_terrain(terrain),
            seconds=seconds,
            seed=seed,
            build=options,
        )
        for source in sources
    ]
    runs: list[Run] = []
    try:
        runs.extend(run_with_progress(configs, output, err))
    finally:
        if runs:
            out.print(results_table([run.record for run in runs]))
        for run in runs:
            out.print(f"{run.folder}", soft_wrap=True, highlight=False)
    if any(run.record.status != "ok" for run in runs):
        raise typer.Exit(RUN_FAILED)
