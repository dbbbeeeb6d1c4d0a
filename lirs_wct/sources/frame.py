"""The frame of a world: local origin of a far source, and cut-out window."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import FloatArray, HeightField, OccupancyGrid, Pose2
from lirs_wct.geometry.geodesy import Place
from lirs_wct.geometry.grid import sample_surface
from lirs_wct.ground import Ground, Terrain

MAX_OFFSET = 10_000.0
"""Distance from the origin, meters, beyond which the center of a source becomes the world's origin."""
LARGE_SIDE, DRIVEN_SIDE = 200.0, 50.0
"""Side from which a terrain is driven on a square only, and the side of that square, meters."""
FEW_CELLS = 16
"""Cells along a window's side below which it is resampled."""
SAMPLES = 65
"""Nodes along each side of a resampled window."""
Window = tuple[float, float, float]
"""Center x, y and side, meters."""


class Reading(NamedTuple):
    """Result of the reader of a source.

    Attributes:
        ground: Ground in the world's frame.
        scale: Origin of the meters, a text.
        place: Georeference; None = unknown.
    """

    ground: Ground
    scale: str
    place: Place | None = None


def local_origin(path: Path, low: FloatArray, high: FloatArray, unit: float = 1.0) -> tuple[float, float]:
    """Return the coordinates of the world's origin; warn unless they are 0, 0.

    The digits of float32 would not suffice for coordinates of a country.

    Args:
        path: path of the source.
        low: smallest x and y of the source.
        high: largest x and y.
        unit: meters per unit of the coordinates.
    """
    if np.abs((low, high)).max() * unit <= MAX_OFFSET:
        return 0.0, 0.0
    x, y = ((low + high) / 2).round().tolist()
    if (x, y) != (0.0, 0.0):
        warnings.warn(
            f"{path}: lies far from its origin: its point {x:.0f}, {y:.0f} becomes 0, 0 of the world",
            stacklevel=3,
        )
    return x, y


def driven_window(surface: HeightField, start: Pose2 | None) -> Window | None:
    """Return the square of a large terrain that is driven; None = all of it.

    Args:
        surface: the terrain.
        start: middle of the square; None = the middle of the terrain.
    """
    if max(surface.size) <= LARGE_SIDE:
        return None
    west, south, east, north = surface.bounds
    middle = start or Pose2((west + east) / 2, (south + north) / 2)
    return middle.x, middle.y, DRIVEN_SIDE


def cut_terrain(ground: Ground, window: Window, *, level: bool = True) -> tuple[Terrain, float]:
    """Return a square of a ground, and the height subtracted from it, meters.

    The terrain names the spacing of the samples where the square is resampled.
    """
    whole, no_ground, lift = ground.surface, ground.no_ground, 0.0
    surface = cut_surface(whole, window)
    spacing = max(whole.cell) if surface.cell != whole.cell else None
    if no_ground is not None:
        col, row = (
            np.rint((start + cell * np.arange(n) - first) / step).astype(int)
            for start, cell, n, first, step in zip(
                *(surface.origin, surface.cell, surface.shape[::-1], whole.origin, whole.cell), strict=True
            )
        )
        no_ground = no_ground[np.ix_(whole.shape[0] - 1 - row[::-1], col)]
    if level:
        surface, lift = leveled(surface)
    return Terrain(surface, no_ground, spacing), lift


def cut_surface(surface: HeightField, window: Window) -> HeightField:
    """Keep the nodes of a square (rounded outward), coordinates unchanged.

    A square of few nodes is resampled, because outward rounding could enlarge it by kilometers.

    Raises:
        ConfigError: the window does not overlap the surface.
    """
    west, south, east, north = surface.bounds
    (x, y, side), half = window, window[2] / 2
    if x + half <= west or x - half >= east or y + half <= south or y - half >= north:
        raise ConfigError(
            f"window {x:g},{y:g},{side:g} lies outside the terrain: "
            f"x {west:g} to {east:g}, y {south:g} to {north:g} m"
        )
    if side < FEW_CELLS * max(surface.cell):
        bounds = (max(x - half, west), max(y - half, south), min(x + half, east), min(y + half, north))
        return sample_surface(surface, bounds, (SAMPLES, SAMPLES))
    rows, cols = surface.shape
    c0, c1 = _span(x - half - west, x + half - west, surface.cell[0], cols)
    r0, r1 = _span(y - half - south, y + half - south, surface.cell[1], rows)
    z = surface.z[rows - 1 - r1 : rows - r0, c0 : c1 + 1]
    return HeightField(
        np.ascontiguousarray(z), surface.cell, (west + c0 * surface.cell[0], south + r0 * surface.cell[1])
    )


def _span(low: float, high: float, cell: float, count: int) -> tuple[int, int]:
    """Return the first and last node that cover [low, high], at least two nodes."""
    first = min(max(math.floor(low / cell + 1e-9), 0), count - 2)
    last = min(max(math.ceil(high / cell - 1e-9), first + 1), count - 1)
    return first, last


def leveled(surface: HeightField) -> tuple[HeightField, float]:
    """Return a surface lowered to z = 0, and the subtracted height, meters."""
    lowest = surface.z.min()
    return replace(surface, z=surface.z - lowest), float(lowest)


def cut_map(grid: OccupancyGrid, window: Window) -> OccupancyGrid:
    """Keep the cells around a square (its bounding box in the grid's own axes).

    Raises:
        ConfigError: the window does not overlap the map.
    """
    x, y, side = window
    corners = [(x + sx * side / 2, y + sy * side / 2) for sx in (-1, 1) for sy in (-1, 1)]
    cells = grid.cells(corners)
    low = np.maximum(cells.min(axis=0), 0)
    high = np.minimum(cells.max(axis=0) + 1, grid.shape)
    if np.any(high <= low):
        raise ConfigError(f"window {x:g},{y:g},{side:g} lies outside the map")
    part = np.ascontiguousarray(grid.log_odds[low[0] : high[0], low[1] : high[1]])
    shift = Pose2(float(low[1]) * grid.resolution, float(low[0]) * grid.resolution)
    return replace(grid, log_odds=part, origin=grid.origin @ shift)
