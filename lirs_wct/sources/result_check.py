"""Check of a built world: each unusual figure becomes a line with its likely cause."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np

from lirs_wct.arrays import Float32Array
from lirs_wct.formats.images.elevation import FLATTEST, STEEPEST
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.ground import LaserMap, Terrain
from lirs_wct.sources.source import Source
from lirs_wct.world import World

MOST_WALLS = 0.5
"""Usual share of wall cells in a map, at most."""
NARROWEST, WIDEST = 1.0, 100_000.0
"""Usual width, meters."""
MIDDLE = 0.05
"""Share of the range at both ends outside which an isolated level leaves no height."""
ISOLATED = 20.0
"""Distance of an isolated level from the other heights, multiple of their range."""


def warn_of_result(source: Source, world: World) -> None:
    """Warn of each figure of a world that is unusual; nothing is refused."""
    for line in unusual_figures(world):
        warnings.warn(f"{source.path}: {line}", stacklevel=3)


def unusual_figures(world: World) -> Iterator[str]:
    """Yield each unusual figure of a world with its likely cause."""
    width = max(world.surface.size)
    if not NARROWEST <= width <= WIDEST:
        yield (
            f"the world is {width:.4g} m wide, usual are {NARROWEST:g} m to {WIDEST / 1000:g} km: "
            "is the unit right? --size and --scale change it"
        )
    if isinstance(world.ground, LaserMap):
        if world.ground.truth is not None:
            yield from _unusual_map(world.ground.truth)
        return
    relief = world.surface.relief if world.solid is None else float(np.ptp(world.solid.vertices[:, 2]))
    if relief > STEEPEST * width:
        yield (
            f"the relief of {relief:.4g} m is {relief / width:.3g} x the width of {width:.4g} m: is a unit "
            'wrong, or do some values mean "no height" (--nodata)?'
        )
    if relief < FLATTEST * width:
        yield (
            f"the ground is flat, {relief:.3g} m of relief on {width:.4g} m: are its heights in another "
            "band, or in the alpha channel?"
        )
    if isinstance(world.ground, Terrain) and world.ground.no_ground is None:
        yield from _isolated_level(world.surface.z)


def _unusual_map(grid: OccupancyGrid) -> Iterator[str]:
    walls, free = float(grid.occupied.mean()), int(grid.free.sum())
    causes = "occupied_thresh, free_thresh, negate, mode and transparency decide"
    if walls == 0 or walls > MOST_WALLS:
        yield f"{walls:.3g} of its cells are walls, usual are above 0 and up to {MOST_WALLS:g}: {causes}"
    if free == 0:
        yield f"none of its {grid.occupied.size} cells is free: {causes}"


def _isolated_level(z: Float32Array) -> Iterator[str]:
    """Yield the heights far outside all others."""
    low, high = float(z.min()), float(z.max())
    margin = MIDDLE * (high - low)
    below, above = z < low + margin, z > high - margin
    if low == high or int(below.sum()) + int(above.sum()) < z.size:
        return
    few, others = (below, above) if below.sum() < above.sum() else (above, below)
    part, rest = z[few], z[others]
    gap = max(float(rest.min() - part.max()), float(part.min() - rest.max()))
    if np.ptp(rest) > 0 and gap > ISOLATED * np.ptp(rest):
        side = "below" if few is below else "above"
        yield (
            f"{part.size} of {z.size} heights lie {gap:.4g} m {side} all others, "
            f'which span {np.ptp(rest):.3g} m: do they mean "no height"? --nodata VALUE says so'
        )
