"""The command `list`: mappers, robots, lidars and bundled worlds, and the data of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from lirs_validation.cli.progress import out
from lirs_wct.errors import unknown_name
from lirs_wct.option import Options, argument

if TYPE_CHECKING:
    from lirs_envs.robots.robot import Robot

Data = Mapping[str, str]
"""Values by heading."""


@dataclass(frozen=True, kw_only=True)
class ListOptions(Options):
    """Names that `list` shows."""

    kind: Literal["mappers", "robots", "lidars", "worlds"] = argument(
        "Kind of names.", "mappers|robots|lidars|worlds"
    )
    name: str | None = argument("One of them: all of its data.", "[NAME]", None)


def list_names(options: ListOptions) -> None:
    """List mappers, robots, lidars or bundled worlds: what each needs and is.

    Examples:
    lirs-wct list mappers
    lirs-wct list robots husky
    """
    from rich.table import Table

    rows = CATALOGS[options.kind]()
    if options.name is not None and options.name not in rows:
        raise unknown_name(options.kind.removesuffix("s"), options.name, rows)
    if options.name is not None:
        table = Table(title=options.name, show_header=False, title_justify="left")
        data = robot_data(options.name) if options.kind == "robots" else rows[options.name]
        for heading, value in data.items():
            table.add_row(heading, value.replace("[", r"\["))
    else:
        table = Table(box=None, pad_edge=False)
        table.add_column(options.kind.removesuffix("s"), no_wrap=True)
        for heading in next(iter(rows.values())):
            table.add_column(heading)
        for name, data in rows.items():
            table.add_row(name, *(value.replace("[", r"\[") for value in data.values()))
    out.print(table)
    if options.kind == "mappers":
        out.print("Your own: --mapper MODULE:CLASS (docs/bring_your_own_mapper.md).", highlight=False)


def _mappers() -> dict[str, Data]:
    from lirs_envs.lidar.presets import RING_LIDARS
    from slam_baselines.mapper import (
        ALL_CLOUD_MAPPERS,
        MAPPERS,
        OWN_CLOUD_MAPPERS,
        make_mapper,
        requires_odometry,
    )

    headings = ("estimates", "reads", "needs", "license", "installed")
    rows: dict[str, tuple[str, ...]] = {}
    for name in MAPPERS:
        needs = "any lidar, odometry" if requires_odometry(make_mapper(name)) else "any lidar"
        rows[name] = ("planar", "scans, odometry, IMU", needs, "ours", "yes")
    clouds = f"clouds of {' or '.join(RING_LIDARS)}"
    for name, method in ALL_CLOUD_MAPPERS.items():
        installed = "yes" if name in OWN_CLOUD_MAPPERS or method.installed else f"no: {method.install}"
        rows[name] = ("3D", clouds, method.needs or "-", method.license, installed)
    return {name: dict(zip(headings, row, strict=True)) for name, row in rows.items()}


def _robots() -> dict[str, Data]:
    from lirs_envs.robots.robot import ROBOTS

    return {name: _common_data(robot) for name, robot in ROBOTS.items()}


def _common_data(robot: Robot) -> dict[str, str]:
    return {
        "speed": f"{robot.max_speed:g} m/s, {robot.max_turn_rate:g} rad/s",
        "radius": f"{robot.radius:g} m",
        "drives on": f"slopes up to {math.degrees(robot.max_slope):.0f} deg",
        "laser": robot.lidar,
    }


def robot_data(name: str) -> Data:
    """Return all data of a robot."""
    import mujoco

    from lirs_envs.robots.robot import make_robot

    robot = make_robot(name)
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    body, T = model.body("base_link"), robot.T_base_laser
    wheels = len(robot.left_wheels) + len(robot.right_wheels)
    size = f"radius {robot.wheel_radius:g} m, track {robot.track:g} m, wheelbase {robot.wheelbase:g} m"
    return {
        "mass": f"{model.body_mass.sum():.4g} kg, body {float(body.mass[0]):.4g} kg",
        "inertia of the body": " ".join(f"{v:.4g}" for v in body.inertia) + " kg m2",
        "drive": f"{len(robot.rotors)} rotors" if robot.flies else f"{wheels} driven wheels",
        **({} if robot.flies else {"wheels": size}),
        "acceleration": f"{robot.max_acceleration:g} m/s2, {robot.max_turn_acceleration:.3g} rad/s2",
        "base_link": f"{robot.base_height:g} m above ground",
        "friction": f"{robot.friction:g} (slides at {math.degrees(math.atan(robot.friction)):.0f} deg)",
        **_common_data(robot),
        "laser's mount": f"{T.x:g} {T.y:g} {T.z:g} m from base_link",
        "timestep": f"{1e3 * model.opt.timestep:g} ms",
        "model": str(robot.mjcf),
    }


def _lidars() -> dict[str, Data]:
    from lirs_envs.lidar.presets import LIDARS, make_lidar_preset

    lidars = {name: make_lidar_preset(name) for name in LIDARS}
    return {
        name: {
            "beams": f"{lidar.beams}",
            "field of view": f"{math.degrees(lidar.fov):g} deg",
            "rate": f"{lidar.rate:g} Hz",
            "range": f"{lidar.range_min:g} to {lidar.range_max:g} m",
        }
        for name, lidar in lidars.items()
    }


def _worlds() -> dict[str, Data]:
    from lirs_wct.sources.bundled import RECIPES, SIZE

    return {
        name: {
            "size": f"{SIZE:g} x {SIZE:g} m",
            "relief of the hills": f"{recipe.relief:g} m",
            "obstacles": f"{recipe.obstacles}",
        }
        for name, recipe in RECIPES.items()
    }


CATALOGS: dict[str, Callable[[], dict[str, Any]]] = {
    "mappers": _mappers,
    "robots": _robots,
    "lidars": _lidars,
    "worlds": _worlds,
}
