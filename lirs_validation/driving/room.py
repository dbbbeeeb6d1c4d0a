"""Suggest robots and sizes when a world is too small."""

from __future__ import annotations

import math
from dataclasses import replace

from lirs_envs.robots.catalog import ROBOTS
from lirs_envs.robots.robot import Robot
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.ground import Terrain
from lirs_wct.world import World

CELLS = 500
"""Cells along the longer side, at most, of the grid on which room is looked for."""
LARGEST = 1000.0
"""How many times larger a world is tried, at most."""
HALVINGS = 7
"""Of the interval between a size that is too small and one that is enough: to 1 % of the doubling."""


def no_room(source: str, world: World, robot: Robot, margin: float) -> ConfigError:
    """Return the error for a world without space for a robot.

    It names robots that fit, and a sufficient size.

    Args:
        source: as the user called it.
        world: that has no place.
        robot: that needs one.
        margin: meters that it needs beyond its radius.
    """
    needed = (
        f"{source}: no place for {robot.name}: it needs {2 * (robot.radius + margin):.1f} m of free "
        f"ground no steeper than {math.degrees(robot.max_slope):.0f} deg"
    )
    others = [name for name, other in ROBOTS.items() if _fits(world, other, margin)]
    hints = [f"{', '.join(others)} would fit" if others else "no other robot fits"]
    size = enough_size(world, robot, margin)
    if size is not None:
        hints.append(f"{robot.name} does from --size {size:g}")
    return ConfigError(f"{needed}; {'; '.join(hints)}")


def enough_size(world: World, robot: Robot, margin: float) -> float | None:
    """Return a sufficient longer side of a terrain, meters; None if none is found.

    The heights stay as they are, as they do with `--size`.
    """
    if world.kind == "map" or world.overhangs:
        return None
    longer = max(world.surface.size)
    low, high = 1.0, 2.0
    while not _fits(_stretch(world, high), robot, margin):
        low, high = high, 2 * high
        if high > LARGEST:
            return None
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if _fits(_stretch(world, middle), robot, margin) else (middle, high)
    return _rounded_up(high * longer)


def _stretch(world: World, factor: float) -> World:
    surface = world.surface
    cell, origin = ((pair[0] * factor, pair[1] * factor) for pair in (surface.cell, surface.origin))
    return replace(world, ground=Terrain(HeightField(surface.z, cell, origin), world.no_ground), start=None)


def _fits(world: World, robot: Robot, margin: float) -> bool:
    resolution = max(0.1, max(world.surface.size) / CELLS)
    free = world.traversable(
        clearance=robot.radius + margin, max_slope=robot.max_slope, resolution=resolution
    )
    return bool(world.driven(free).free.any())


def _rounded_up(number: float) -> float:
    """Return a number rounded up to two digits."""
    unit: float = 10.0 ** (math.floor(math.log10(number)) - 1)
    return math.ceil(number / unit) * unit
