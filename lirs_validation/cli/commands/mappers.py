"""The command `mappers`: names for `--mapper`, and the requirements of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lirs_validation.cli.progress import out

if TYPE_CHECKING:
    from rich.table import Table


def mappers() -> None:
    """List the mappers: planar or 3D, required data, license, and how to install them."""
    out.print(mapper_table())
    out.print("Your own: --mapper MODULE:CLASS (docs/bring_your_own_mapper.md).", highlight=False)


def mapper_table() -> Table:
    """Return a row a mapper."""
    from rich.table import Column, Table

    from lirs_envs.lidar.presets import RING_LIDARS
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
        held = "yes" if name in OWN_CLOUD_MAPPERS or method.installed else f"no: {method.install}"
        table.add_row(name, "3D", clouds, method.needs or "-", method.license, held.replace("[", r"\["))
    return table
