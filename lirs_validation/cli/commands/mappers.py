"""The command `mappers`: names for `--mapper`, and the requirements of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lirs_validation.cli.console import out

if TYPE_CHECKING:
    from rich.table import Table


def mappers() -> None:
    """List the mappers: planar or 3D, required sensors, and how to install them."""
    out.print(mapper_table())
    out.print("Your own: --mapper MODULE:CLASS (docs/bring_your_own_mapper.md).", highlight=False)


def mapper_table() -> Table:
    """Return a row a mapper."""
    from rich.table import Table

    from lirs_envs.lidar.presets import RING_LIDARS
    from slam_baselines.mapper import CLOUD_MAPPERS, MAPPERS, make_mapper, requires_odometry

    table = Table("mapper", "estimates", "reads", "needs", "installed", box=None, pad_edge=False)
    for name in MAPPERS:
        needs = "any lidar, odometry" if requires_odometry(make_mapper(name)) else "any lidar"
        table.add_row(name, "planar", "scans, odometry, IMU", needs, "yes")
    for name, method in CLOUD_MAPPERS.items():
        lidars = f"--lidar {' or '.join(RING_LIDARS)}, package {method.distribution}"
        installed = "yes" if method.installed else f"no: {method.install}"
        table.add_row(name, "3D", "point clouds", lidars, installed.replace("[", r"\["))
    return table
