"""The command `mappers`: names for `--mapper`, the requirements of each, and its installation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from lirs_validation.cli.progress import err, out

if TYPE_CHECKING:
    from rich.table import Table


def mappers(
    install: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Install a third-party system into an environment of its own."),
    ] = None,
) -> None:
    """List the mappers: planar or 3D, required data, license, and how to install them."""
    if install is not None:
        from lirs_validation.experiment.mapper_loading import install as install_system

        with err.status(f"installing {install}"):
            folder = install_system(install)
        out.print(f"{folder}", soft_wrap=True, highlight=False)
        return
    out.print(mapper_table())
    out.print("Your own: --mapper MODULE:CLASS (docs/bring_your_own_mapper.md).", highlight=False)


def mapper_table() -> Table:
    """Return a row a mapper."""
    from rich.table import Column, Table

    from lirs_envs.lidar.presets import RING_LIDARS
    from lirs_validation.experiment.mapper_loading import is_installed
    from slam_baselines.mapper import (
        ALL_CLOUD_MAPPERS,
        MAPPERS,
        OWN_CLOUD_MAPPERS,
        make_mapper,
        requires_odometry,
    )

    table = Table(Column("mapper", no_wrap=True), box=None, pad_edge=False)
    for heading in ("estimates", "reads", "needs", "license", "installed"):
        table.add_column(heading)
    for name in MAPPERS:
        needs = "any lidar, odometry" if requires_odometry(make_mapper(name)) else "any lidar"
        table.add_row(name, "planar", "scans, odometry, IMU", needs, "ours", "yes")
    clouds = f"clouds of {' or '.join(RING_LIDARS)}"
    for name, method in ALL_CLOUD_MAPPERS.items():
        held = "yes" if name in OWN_CLOUD_MAPPERS or is_installed(method) else f"no: {method.install}"
        table.add_row(name, "3D", clouds, method.needs or "-", method.license, held.replace("[", r"\["))
    return table
