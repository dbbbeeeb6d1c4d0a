"""The command `export`: a finished run for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lirs_validation.cli.console import err, out


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
    from lirs_wct.option import chosen, read_names

    stored = chosen(storage, "--storage", ("mcap", "sqlite3"))
    formats = read_names(to, "--to")
    with err.status(f"exporting {run}"):
        folder = output or run / "export"
        written = export_run(read_run(run), folder, formats, storage=stored, slam=not sensors_only)
    for path in written:
        out.print(f"{path}", soft_wrap=True, highlight=False)
