"""Check of a built world: each unusual figure becomes a line with its likely cause."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np

from lirs_wct.arrays import Float32Array
from lirs_wct.formats.images.elevation import FLATTEST, STEEPEST
from lirs_wct.ground import LaserMap, Terrain
from lirs_wct.sources.options import SourceKind
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
    for line in unusual_figures(world, source.kind):
        warnings.warn(f"{source.path}: {line}", stacklevel=3)


def unusual_figures(world: World, kind: SourceKind) -> Iterator[str]:
    """Yield each unusual figure of a world with its likely cause."""
    width, is_picture = max(world.surface.size), kind is SourceKind.PICTURE
    change = " --size and --scale change it" if kind in (SourceKind.PICTURE, SourceKind.MESH) else ""
    if not NARROWEST <= width <= WIDEST:
        yield (
            f"the world is {width:.4g} m wide, usual are {NARROWEST:g} m to {WIDEST / 1000:g} km: "
            f"is the {'resolution' if isinstance(world.ground, LaserMap) else 'unit'} right?{change}"
        )
    if isinstance(world.ground, LaserMap):
        yield from _unusual_map(world.ground)
        return
    relief = world.surface.relief if world.solid is None else float(np.ptp(world.solid.vertices[:, 2]))
    if relief > STEEPEST * width:
        codes = ', or do some values mean "no height" (--option nodata=VALUE)' if is_picture else ""
        times = f"{relief / width:.3g} x the width of {width:.4g} m"
        yield f"the relief of {relief:.4g} m is {times}: is a unit wrong{codes}?"
    if relief < FLATTEST * width:
        place = ": are its heights in another band, or in the alpha channel?" if is_picture else ""
        yield f"the ground is flat, {relief:.3g} m of relief on {width:.4g} m{place}"
    if isinstance(world.ground, Terrain) and world.ground.no_ground is None:
        says = " --option nodata=VALUE says so" if is_picture else ""
        yield from _isolated_level(world.surface.z, says)


def _unusual_map(ground: LaserMap) -> Iterator[str]:
    if (grid := ground.truth) is None:
        return
    walls, free = float(grid.occupied.mean()), int(grid.free.sum())
    causes = "occupied_thresh, free_thresh, negate, mode and transparency decide"
    if walls == 0 or walls > MOST_WALLS:
        yield f"{walls:.1%} of its cells are walls, usual are above 0 and up to {MOST_WALLS:.0%}: {causes}"
    if free == 0:
        yield f"none of its {grid.occupied.size} cells is free: {causes}"


def _isolated_level(z: Float32Array, says: str) -> Iterator[str]:
    """Yield the heights far outside all others, with a hint."""
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
            f'which span {np.ptp(rest):.3g} m: do they mean "no height"?{says}'
        )
